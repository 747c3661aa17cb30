"""Quick parsing of C type names gives the types that cffi's own parsing gives."""

from __future__ import annotations

import cffi
import pytest

from orogen.gpu.quick_types import quicken_type_parsing

HEADER = "".join(
    f"typedef struct S{i} {{ int a{i}; struct S{i} *next; }} T{i}; typedef T{i} *P{i};" for i in range(200)
)
TYPES = ("T7 *", "P9[]", "struct S3 *", "void(*)(T1 const *, P2, uint8_t, void *)", "uint32_t []", "char []", "T5[4]")


def prepared() -> cffi.FFI:
    ffi = cffi.FFI()
    ffi.cdef(HEADER)
    return ffi


@pytest.mark.parametrize("name", TYPES)
def test_types_are_the_same(name: str) -> None:
    plain, quick = prepared(), prepared()
    assert quicken_type_parsing(quick)
    expected, got = plain.typeof(name), quick.typeof(name)
    assert (got.kind, got.cname) == (expected.kind, expected.cname)


def test_unknown_names_and_later_declarations() -> None:
    ffi = prepared()
    assert quicken_type_parsing(ffi)
    assert quicken_type_parsing(ffi)
    with pytest.raises(cffi.CDefError):
        ffi.typeof("Unknown *")
    ffi.cdef("typedef T3 Later;")
    assert ffi.new("Later *").next == ffi.NULL
    assert ffi.typeof("Later") is ffi.typeof("T3")


def test_only_the_names_that_are_used_are_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    from cffi import cparser

    sources: list[str] = []
    real = cparser._get_parser

    class Spy:
        def parse(self, source: str) -> object:
            sources.append(source)
            return real().parse(source)

    ffi = prepared()
    assert quicken_type_parsing(ffi)
    monkeypatch.setattr(cparser, "_get_parser", Spy)
    ffi.typeof("T150 *")
    assert "T150" in sources[-1]
    assert "T149" not in sources[-1]


def test_anything_else_is_left_alone() -> None:
    assert not quicken_type_parsing(object())
