from __future__ import annotations

import pytest

from orogen.errors import ShaderError
from orogen.gpu.wgsl import Text, compose


@pytest.fixture
def files(tmp_path):
    def write(**contents: str):
        for name, text in contents.items():
            path = tmp_path / (name.replace("__", "/") + ".wgsl")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        return tmp_path

    return write


def test_each_file_comes_once_and_before_its_user(files):
    root = files(
        own__main="#include a.wgsl\n#include b.wgsl\nfn main() {}\n",
        own__a="#include c.wgsl\nfn a() {}\n",
        shared__b="#include c.wgsl  // again\nfn b() {}\n",
        shared__c="fn c() {}\n",
    )
    composed = compose(root / "own" / "main.wgsl", search=[root / "shared"])
    assert composed.text == "fn c() {}\nfn a() {}\nfn b() {}\nfn main() {}\n"
    assert [str(line) for line in composed.lines] == [
        "shared/c.wgsl:1",
        "own/a.wgsl:2",
        "shared/b.wgsl:2",
        "own/main.wgsl:3",
    ]


def test_file_beside_the_user_comes_before_the_search_folders(files):
    root = files(own__main="#include a.wgsl\n", own__a="const own = 1;\n", shared__a="const shared = 1;\n")
    assert compose(root / "own" / "main.wgsl", search=[root / "shared"]).text == "const own = 1;\n"


def test_sources_of_all_three_kinds(files):
    root = files(shared__a="fn a() {}\n", shared__b="#include a.wgsl\nfn b() {}\n")
    glue = Text("glue", "#include a.wgsl\nfn main() { a(); b(); }")
    composed = compose(root / "shared" / "a.wgsl", "b.wgsl", glue, search=[root / "shared"])
    assert composed.text == "fn a() {}\nfn b() {}\nfn main() { a(); b(); }\n"
    assert str(composed.line(3)) == "glue:2"
    assert str(composed.line(99)) == "glue:2"


def test_unknown_name_lists_the_known(files):
    root = files(own__main="\n#include frme.wgsl\n", shared__frame="", shared__deep="")
    with pytest.raises(ShaderError, match=r"own/main.wgsl:2: .*'frme.wgsl'; known: deep.wgsl, frame.wgsl, main.wgsl"):
        compose(root / "own" / "main.wgsl", search=[root / "shared"])
    with pytest.raises(ShaderError, match=r"'gone.wgsl'; known: none"):
        compose("gone.wgsl")


def test_cycle_is_named(files):
    root = files(o__a="#include b.wgsl\n", o__b="\n\n#include c.wgsl\n", o__c="#include b.wgsl\n")
    with pytest.raises(ShaderError, match=r"o/c.wgsl:1: .*cycle, got b.wgsl -> c.wgsl -> b.wgsl"):
        compose(root / "o" / "a.wgsl")


def test_missing_file(tmp_path):
    with pytest.raises(ShaderError, match=r"cannot read the WGSL file .*nowhere.wgsl"):
        compose(tmp_path / "nowhere.wgsl")


def test_constants():
    code = "const a = #{N}u; const b = #{X}; const c: #{T} = #{ON}; // not #{THIS}"
    composed = compose(Text("t", code), constants={"N": 7, "X": 0.25, "T": "bool", "ON": True})
    assert composed.text == "const a = 7u; const b = 0.25; const c: bool = true; // not #{THIS}\n"


def test_constant_in_an_include(files):
    root = files(o__a="#include b.wgsl\n", o__b="const n = #{N};\n")
    assert compose(root / "o" / "a.wgsl", constants={"N": 1e-9}).text == "const n = 1e-09;\n"


def test_unknown_constant_names_file_and_line():
    with pytest.raises(ShaderError, match=r"t:2: .*got #\{SIZ\}; known: SIZE"):
        compose(Text("t", "\nconst a = #{SIZ};"), constants={"SIZE": 1})
    with pytest.raises(ShaderError, match="constant SIZE: expected a finite number, got nan"):
        compose(Text("t", ""), constants={"SIZE": float("nan")})


@pytest.mark.parametrize("line", ["#define A", "  #import frame", "#include", "#includ a.wgsl"])
def test_unknown_directive(line):
    with pytest.raises(ShaderError, match=r"t:1: expected '#include NAME'"):
        compose(Text("t", line))


def test_directives_of_the_language_move_to_the_front():
    composed = compose(Text("a", "fn a() {}"), Text("b", "enable f16;  // half\nfn b() {}"))
    assert composed.text == "enable f16;  // half\nfn a() {}\nfn b() {}\n"
    assert str(composed.line(1)) == "b:1"
