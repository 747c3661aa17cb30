"""Patterns as an OpenGL driver's tessellator makes them: `python tests/lod/tessellator.py` writes tessellator.npz anew.

Needs `moderngl`, `PyOpenGL` and an OpenGL 4 driver (Mesa's llvmpipe made the file), which the tests do not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FILE = Path(__file__).with_suffix(".npz")
LAYOUTS = {
    "integer": "equal_spacing",
    "fractional_even": "fractional_even_spacing",
    "fractional_odd": "fractional_odd_spacing",
}

VERTEX = "#version 400 core\nvoid main() { gl_Position = vec4(0.0); }"
CONTROL = """
#version 400 core
layout(vertices = 1) out;
uniform vec4 outer;
uniform vec2 inner;
void main() {
    for (int i = 0; i < 4; i++) gl_TessLevelOuter[i] = outer[i];
    for (int i = 0; i < 2; i++) gl_TessLevelInner[i] = inner[i];
}
"""
EVALUATION = """
#version 400 core
layout(quads, SPACING, cw) in;
out vec2 parameters;
void main() { parameters = gl_TessCoord.xy; gl_Position = vec4(0.0); }
"""


def factors() -> NDArray[np.float32]:
    """(n, 6) outer factors west, north, east, south, then inner ones along u and v."""
    random = np.random.default_rng(5)
    equal = [[f] * 6 for f in (1, 1.3, 2, 2.5, 3, 4, 5, 6.7, 7, 8, 9.25, 16, 17)]
    thin = [[1, 1, 1, 1, 1, 7], [1, 1, 1, 1, 8, 3], [5, 2, 5, 2, 2, 5], [3, 9, 3, 9, 9, 3], [1, 4, 6, 11, 1, 1]]
    mixed = 2 ** random.uniform(0, 4.0, (24, 6))
    whole = np.ceil(2 ** random.uniform(0, 3.5, (10, 6)))
    # inside as fine as the finest edge, as terrain asks for
    finer = mixed[:8].copy()
    finer[:, 4:] = np.maximum(finer[:, [0, 1]], finer[:, [2, 3]])
    large = [[64, 63, 62.5, 33, 30, 33.7], [1, 64, 2, 63, 64, 3.2]]
    return np.concatenate([equal, thin, mixed, whole, finer, large]).astype(np.float32)


def canonical(triangles: NDArray[np.integer]) -> NDArray[np.uint32]:
    """(n, 3, 2) triangles in one order, and the corners of each in one order."""
    corners = triangles[..., 0].astype(np.int64) << 32 | triangles[..., 1]
    corners = np.sort(corners, axis=1)
    corners = corners[np.lexsort(corners.T[::-1])]
    return np.stack([corners >> 32, corners & 0xFFFFFFFF], axis=-1).astype(np.uint32)


def main() -> None:
    """Write what the tessellator makes of all factors with all spacings."""
    import moderngl
    from OpenGL import GL

    context = moderngl.create_standalone_context(backend="egl")
    context.patch_vertices = 1
    context.simple_framebuffer((1, 1)).use()
    result = {"factors": factors()}
    for name, layout in LAYOUTS.items():
        program = context.program(
            vertex_shader=VERTEX,
            tess_control_shader=CONTROL,
            tess_evaluation_shader=EVALUATION.replace("SPACING", layout),
            varyings=["parameters"],
        )
        array = context.vertex_array(program, [])
        buffer, query = context.buffer(reserve=8 * 3 * 8192), context.query(primitives=True)
        parts = []
        for row in factors():
            program["outer"], program["inner"] = tuple(row[:4].tolist()), tuple(row[4:].tolist())
            with query:
                GL.glUseProgram(program.glo)
                GL.glBindVertexArray(array.glo)
                GL.glBindBufferBase(GL.GL_TRANSFORM_FEEDBACK_BUFFER, 0, buffer.glo)
                GL.glEnable(GL.GL_RASTERIZER_DISCARD)
                GL.glBeginTransformFeedback(GL.GL_TRIANGLES)
                GL.glDrawArrays(GL.GL_PATCHES, 0, 1)
                GL.glEndTransformFeedback()
            values = np.frombuffer(buffer.read(24 * query.primitives), np.float32).reshape(-1, 3, 2)
            parts.append(canonical((values.astype(np.float64) * 65536).astype(np.uint32)))
        result[name] = np.concatenate(parts)
        result[f"{name} counts"] = np.array([len(part) for part in parts])
    np.savez_compressed(FILE, **result)


if __name__ == "__main__":
    main()
