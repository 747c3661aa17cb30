"""pygfx: the whole height map as a mesh."""

import math

import numpy as np
import pygfx
from peer import Scene, run
from rendercanvas.offscreen import RenderCanvas


class Drawer:
    """An off-screen canvas with the mesh."""

    def __init__(self, scene: Scene) -> None:
        self.canvas = RenderCanvas(size=scene.size, pixel_ratio=1)
        self.renderer = pygfx.renderers.WgpuRenderer(self.canvas, pixel_ratio=1)
        self.renderer.ppaa = "none"
        self.camera = pygfx.PerspectiveCamera()
        self.scene = pygfx.Scene()
        self.scene.add(pygfx.Background.from_color("#000"))
        # texture coordinates count from the upper left
        places = scene.places().copy()
        places[:, 1] = 1 - places[:, 1]
        rgba = np.dstack([scene.texture, np.full(scene.texture.shape[:2], 255, np.uint8)])
        geometry = pygfx.Geometry(
            positions=scene.positions().astype(np.float32),
            indices=scene.triangles(),
            texcoords=places.astype(np.float32),
        )
        texture = pygfx.Texture(np.ascontiguousarray(rgba), dim=2, colorspace="srgb", generate_mipmaps=True)
        material = pygfx.MeshBasicMaterial(map=pygfx.TextureMap(texture, filter="linear", mipmap_filter="linear"))
        self.scene.add(pygfx.Mesh(geometry, material))
        self.canvas.request_draw(lambda: self.renderer.render(self.scene, self.camera))

    def draw(self, view):
        """The picture, (height, width, 3)."""
        # its angle belongs to the mean of the picture's width and height
        half = math.tan(math.radians(view.fov) / 2) * (1 + view.aspect) / 2
        self.camera.fov, self.camera.aspect = math.degrees(2 * math.atan(half)), view.aspect
        self.camera.depth_range = view.near, view.far
        self.camera.local.position = view.eye
        self.camera.world.reference_up = (0, 0, 1)
        self.camera.look_at(view.target)
        return np.asarray(self.canvas.draw())[..., :3]


run(Drawer)
