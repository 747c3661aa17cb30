from __future__ import annotations

import json

import numpy as np

from orogen.gpu import Text


def test_labels_are_on_every_object(gpu):
    shader = gpu.shader("shader", Text("s", "@compute @workgroup_size(1) fn main() {}"))
    layout = gpu.layout("layout", {0: ("COMPUTE", "uniform")})
    buffer = gpu.buffer("buffer", np.zeros(4, np.float32), "UNIFORM", "test")
    texture = gpu.texture("texture", (2, 2), "r8unorm", "TEXTURE_BINDING", "test")
    objects = {
        "shader": shader.raw,
        "layout": layout,
        "buffer": buffer.raw,
        "texture": texture.raw,
        "pipeline": gpu.compute("pipeline", shader, "main"),
        "group": gpu.bind("group", layout, {0: buffer}),
        "sampler": gpu.sampler("sampler", min_filter="linear"),
        "encoder": gpu.encoder("encoder"),
    }
    assert {name: made.label for name, made in objects.items()} == {name: name for name in objects}
    assert texture.view() is texture.view()
    assert texture.view().label == "texture"
    assert texture.view(dimension="2d-array") is not texture.view()


def test_description_is_plain(gpu):
    told = json.loads(json.dumps(gpu.describe()))
    assert told["kind"] == gpu.info.kind
    assert told["limits"]["max-texture-array-layers"] >= 256
    assert {name for name, on in told["features"].items() if on} == gpu.features
    assert told["memory"]["total"] == sum(told["memory"]["categories"].values())
