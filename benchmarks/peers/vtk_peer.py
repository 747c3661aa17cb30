"""PyVista (VTK): the whole height map as a structured mesh."""

import pyvista
from peer import Scene, run


class Drawer:
    """A plotter with the mesh."""

    def __init__(self, scene: Scene) -> None:
        rows, columns = scene.heights.shape
        x, y, z = scene.positions().reshape(rows, columns, 3).transpose(2, 0, 1)
        mesh = pyvista.StructuredGrid(x, y, z)
        # VTK counts the points of a structured mesh down the columns first
        mesh.active_texture_coordinates = scene.places().reshape(rows, columns, 2).transpose(1, 0, 2).reshape(-1, 2)
        self.plotter = pyvista.Plotter(off_screen=True, window_size=scene.size)
        # one sample a pixel, as all others
        self.plotter.disable_anti_aliasing()
        self.plotter.background_color = "black"
        # the first row of the picture is the upper one, where v is 1
        texture = pyvista.numpy_to_texture(scene.texture)
        texture.SetMipmap(True)
        texture.SetInterpolate(True)
        texture.SetMaximumAnisotropicFiltering(8)
        self.plotter.add_mesh(mesh, texture=texture, lighting=False, show_edges=False)

    def draw(self, view):
        """The picture, (height, width, 3)."""
        camera = self.plotter.camera
        camera.position, camera.focal_point, camera.up = view.eye, view.target, (0.0, 0.0, 1.0)
        camera.view_angle = view.fov
        camera.clipping_range = view.near, view.far
        self.plotter.render()
        return self.plotter.screenshot(return_img=True)[..., :3]


run(Drawer)
