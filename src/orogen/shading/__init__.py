"""Surface buffer to colour, ignorant of the algorithm that drew it: albedo, light, shadows, haze, overlays.

One sample of a picture after another, then the picture:

    shading = Shading(gpu, scene_layout, surface_layout, search, constants)
    samples = shading.samples((1920, 1080))
    shading.record(encoder, timer, frame, scene_group, surface_group, samples, style)
    shading.resolve(encoder, timer, samples, texture.view(), style)

Importing the room does not load the GPU.
"""

from orogen.shading.ramp import ramps
from orogen.shading.shade import Samples, Shading
from orogen.shading.style import COLOR_MODES, OVERLAYS, Style

__all__ = ["COLOR_MODES", "OVERLAYS", "Samples", "Shading", "Style", "ramps"]
