"""The only room that knows the GPU's device: adapters, shaders, memory, timing and read-back.

`open_gpu` gives a `Gpu`; everything else is asked of that. The page docs/gpu.md shows it at work.
"""

from orogen.gpu.adapters import AdapterInfo, adapters
from orogen.gpu.device import Gpu, open_gpu
from orogen.gpu.memory import MemoryAccount
from orogen.gpu.readback import Readback
from orogen.gpu.resources import Buffer, Texture
from orogen.gpu.shader import Shader
from orogen.gpu.timer import FrameTimer
from orogen.gpu.wgsl import Text

__all__ = [
    "AdapterInfo",
    "Buffer",
    "FrameTimer",
    "Gpu",
    "MemoryAccount",
    "Readback",
    "Shader",
    "Text",
    "Texture",
    "adapters",
    "open_gpu",
]
