"""The errors that orogen raises, one small tree.

    OrogenError
    ├── InputError           what the user handed over cannot be used
    │   ├── SourceError      a raster: missing, unreadable ...
    │   │   └── NoSampleError  it can be read, but all of it is nodata
    │   ├── SettingsError    a setting, option, camera or name out of its range
    │   └── OutputError      a place that cannot be written
    ├── StoreError           a pyramid store is damaged or incomplete
    └── GpuError             the GPU cannot do what was asked
        ├── NoAdapterError   no usable adapter on this machine
        ├── ShaderError      a WGSL file does not compile (names file and line)
        ├── BudgetError      an allocation would exceed the memory budget
        └── DeviceLostError  the device is gone, with all that was on it: open another one

A message says what was expected, what came, and what to do about it.
"""


class OrogenError(Exception):
    """Base of every error that orogen raises on purpose."""


class InputError(OrogenError, ValueError):
    """What the user handed over cannot be used."""


class SourceError(InputError):
    """A raster is missing, unreadable, of a kind that cannot be used, or has no valid sample."""


class NoSampleError(SourceError):
    """A raster can be read, but has no valid sample."""


class SettingsError(InputError):
    """A setting, an option, a camera or a name is out of its range."""


class OutputError(InputError):
    """A file or folder cannot be written."""


class StoreError(OrogenError):
    """A pyramid store is damaged or incomplete."""


class GpuError(OrogenError, RuntimeError):
    """The GPU cannot do what was asked."""


class NoAdapterError(GpuError):
    """No usable GPU adapter, not even a software one, was found."""


class ShaderError(GpuError):
    """A WGSL source does not resolve or compile; the message names the file and the line."""


class BudgetError(GpuError):
    """An allocation would exceed the GPU memory budget."""


class DeviceLostError(GpuError):
    """The device is gone (driver reset, device removed): nothing on it can be used any more."""
