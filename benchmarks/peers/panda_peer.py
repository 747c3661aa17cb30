"""Panda3D: its terrain with levels of detail (GeoMipTerrain)."""

import numpy as np
from panda3d.core import (
    GeoMipTerrain,
    GraphicsOutput,
    LPoint3f,
    PNMImage,
    Texture,
    TextureStage,
    loadPrcFileData,
)
from peer import Scene, run

loadPrcFileData(
    "", "load-display p3headlessgl\naux-display p3tinydisplay\nwindow-type offscreen\naudio-library-name null"
)


class Drawer:
    """An off-screen window with the terrain."""

    def __init__(self, scene: Scene) -> None:
        from direct.showbase.ShowBase import ShowBase

        loadPrcFileData("", f"win-size {scene.size[0]} {scene.size[1]}")
        self.base = ShowBase(windowType="offscreen")
        self.base.setBackgroundColor(0, 0, 0)
        rows, columns = scene.heights.shape
        low, high = float(scene.heights.min()), float(scene.heights.max())
        image = PNMImage(columns, rows, 1, 65535)
        steps = np.rint((scene.heights - low) / (high - low) * 65535).astype(int).tolist()
        for row in range(rows):
            for column in range(columns):
                image.setGrayVal(column, row, steps[row][column])
        terrain = GeoMipTerrain("terrain")
        terrain.setHeightfield(image)
        terrain.setBlockSize(64)
        terrain.setBruteforce(False)
        terrain.setNear(40)
        terrain.setFar(400)
        terrain.setFocalPoint(self.base.camera)
        root = terrain.getRoot()
        first = scene.positions()[(rows - 1) * columns]
        root.setPos(float(first[0]), float(first[1]), low)
        root.setScale(scene.spacing, scene.spacing, high - low)
        root.reparentTo(self.base.render)
        terrain.generate()
        texture = Texture()
        texture.setup2dTexture(columns, rows, Texture.TUnsignedByte, Texture.FRgb)
        texture.setRamImageAs(np.ascontiguousarray(scene.texture[::-1]).tobytes(), "RGB")
        texture.setMinfilter(Texture.FTLinearMipmapLinear)
        texture.setAnisotropicDegree(8)
        root.setTexture(texture)
        # its coordinates go from the first sample to the last, a texture's from side to side
        stage = TextureStage.getDefault()
        root.setTexScale(stage, (columns - 1) / columns, (rows - 1) / rows)
        root.setTexOffset(stage, 0.5 / columns, 0.5 / rows)
        self.terrain = terrain
        self.shown = Texture()
        self.base.win.addRenderTexture(self.shown, GraphicsOutput.RTMCopyRam)

    def draw(self, view):
        """The picture, (height, width, 3)."""
        base = self.base
        base.camLens.setFov(view.horizontal_fov, view.fov)
        base.camLens.setNearFar(view.near, view.far)
        base.camera.setPos(*view.eye)
        base.camera.lookAt(LPoint3f(*view.target))
        self.terrain.update()
        base.graphicsEngine.renderFrame()
        width, height = self.shown.getXSize(), self.shown.getYSize()
        pixels = np.frombuffer(self.shown.getRamImageAs("RGB"), np.uint8).reshape(height, width, 3)
        return pixels[::-1].copy()


run(Drawer)
