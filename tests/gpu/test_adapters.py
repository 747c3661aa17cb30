from __future__ import annotations

import os
import subprocess
import sys

import pytest

from orogen.errors import NoAdapterError, SettingsError
from orogen.gpu.adapters import ADAPTER_VARIABLE, AdapterInfo, adapters, choose

MACHINE = [
    AdapterInfo(0, "llvmpipe (LLVM 15)", "cpu", "Vulkan", "Mesa 22"),
    AdapterInfo(1, "Intel Iris Xe", "integrated", "Vulkan", "Mesa 24"),
    AdapterInfo(2, "NVIDIA RTX 4070", "discrete", "Vulkan", "550"),
    AdapterInfo(3, "NVIDIA RTX 6000", "discrete", "Vulkan", "550"),
    AdapterInfo(4, "Paravirtual GPU", "virtual", "Vulkan", ""),
]


@pytest.fixture(autouse=True)
def _no_variable(monkeypatch):
    monkeypatch.delenv(ADAPTER_VARIABLE, raising=False)


@pytest.mark.parametrize(
    ("wanted", "index"),
    [(None, 2), ("cpu", 0), ("integrated", 1), ("virtual", 4), ("3", 3), ("rtx 6000", 3), ("LLVMpipe", 0), ("", 2)],
)
def test_choice(wanted, index):
    assert choose(MACHINE, wanted).index == index


@pytest.mark.parametrize(("present", "index"), [([0, 1, 4], 1), ([0, 4], 4), ([0], 0)])
def test_better_kinds_are_preferred(present, index):
    assert choose([MACHINE[i] for i in present]).index == index


def test_variable_chooses_and_argument_overrules_it(monkeypatch):
    monkeypatch.setenv(ADAPTER_VARIABLE, "cpu")
    assert choose(MACHINE).kind == "cpu"
    assert choose(MACHINE, "integrated").kind == "integrated"


def test_no_fit_lists_what_there_is(monkeypatch):
    with pytest.raises(SettingsError, match=r"(?s)adapter: .*got 'radeon'.*2: NVIDIA RTX 4070 \(discrete, Vulkan\)"):
        choose(MACHINE, "Radeon")
    monkeypatch.setenv(ADAPTER_VARIABLE, "9")
    with pytest.raises(SettingsError, match=f"{ADAPTER_VARIABLE}: .*got '9'"):
        choose(MACHINE)


def test_none_at_all_says_what_to_install(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(NoAdapterError, match="apt install mesa-vulkan-drivers libvulkan1"):
        choose([])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="hides the driver in the way of the Vulkan loader")
def test_machine_without_driver():
    code = "from orogen.errors import NoAdapterError\nfrom orogen.gpu import open_gpu\n"
    code += "try:\n    open_gpu()\nexcept NoAdapterError as error:\n    raise SystemExit(str(error))"
    hidden = {"VK_DRIVER_FILES": "/nonexistent.json", "VK_ICD_FILENAMES": "/nonexistent.json"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | hidden, capture_output=True, text=True)
    assert done.returncode == 1
    assert "no GPU adapter was found" in done.stderr


def test_this_machine(gpu):
    found = adapters()
    assert [info.index for info in found] == list(range(len(found)))
    assert gpu.info in found
    assert gpu.features <= gpu.info.features
