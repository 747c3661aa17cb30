"""The project keeps its own rules: one-way imports, a light start, whole packages, clean text, a page per room."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import orogen

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "orogen"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DISTRIBUTIONS = {
    "PIL": "pillow", "flip_evaluator": "flip-evaluator", "imgui_bundle": "imgui-bundle", "skimage": "scikit-image",
}  # fmt: skip
"""Names of distributions, where the name to import is another."""


OPTIONAL = {"xarray.py": "xarray", "view/serve/server.py": "websockets"}
"""Modules that are only ever imported where an extra is installed, with what that brings."""


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def rooms() -> dict[str, int]:
    """Place of every room in the table of docs/architecture.md; the words of its first row count one by one."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z_ ]+)` \|", text, flags=re.MULTILINE)
    return {name: place for place, name in enumerate(" ".join(rows).split())}


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path: Path, tree: ast.AST) -> Iterator[str]:
    """Absolute dotted names that the module imports, `from a import b` as a.b."""
    package = path.relative_to(PACKAGE.parent).parent.parts
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1]] if node.level else []
            base += node.module.split(".") if node.module else []
            yield from (".".join([*base, alias.name]) for alias in node.names)


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def test_rooms_import_only_rooms_above() -> None:
    order = rooms()
    wrong = []
    for path in modules():
        room = room_of(path)
        if room in ("__init__", "__main__"):
            continue
        assert room in order, f"{room} is missing from the table of docs/architecture.md"
        for name in imports(path, parsed(path)):
            top, _, rest = name.partition(".")
            other = rest.split(".")[0]
            if top == "orogen" and other in order and other != room and order[other] > order[room]:
                wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_algorithms_do_not_import_each_other() -> None:
    lod = PACKAGE / "lod"
    algorithms = {path.name for path in lod.iterdir() if (path / "__init__.py").exists()}
    wrong = []
    for path in sorted(lod.rglob("*.py")):
        own = path.relative_to(lod).parts[0]
        for name in imports(path, parsed(path)):
            parts = name.split(".")
            if parts[:2] == ["orogen", "lod"] and len(parts) > 2 and parts[2] in algorithms - {own}:
                wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong, "\n".join(wrong)


def requirement_names(lines: list[str]) -> set[str]:
    return {re.split(r"[\s\[<>=!~;]", line, maxsplit=1)[0].lower() for line in lines}


def test_only_declared_libraries_are_imported() -> None:
    core = requirement_names(PROJECT["dependencies"])
    extras = set().union(
        *(requirement_names(lines) for name, lines in PROJECT["optional-dependencies"].items() if name != "dev")
    )
    known = set(sys.stdlib_module_names) | {"orogen"}
    wrong = []
    for path in modules():
        tree = parsed(path)
        at_start = ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], [])
        for allowed, names in ((core, imports(path, at_start)), (core | extras, imports(path, tree))):
            for name in names:
                top = name.split(".")[0]
                if OPTIONAL.get(path.relative_to(PACKAGE).as_posix()) == top and top in extras:
                    continue
                if top not in known and DISTRIBUTIONS.get(top, top).lower() not in allowed:
                    wrong.append(f"{path.relative_to(ROOT)} imports {name}, which `pip install orogen` may not bring")
    assert not wrong, "\n".join(wrong)


def test_import_is_light() -> None:
    code = (
        "import json, sys, time; start = time.process_time(); import orogen; "
        "print(json.dumps([time.process_time() - start, sorted(sys.modules)]))"
    )
    runs = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        runs.append(json.loads(done.stdout))
    heavy = {"av", "cyclopts", "glfw", "numpy", "PIL", "rasterio", "rendercanvas", "rich", "tensorstore", "wgpu"}
    assert heavy.isdisjoint(runs[0][1])
    assert min(seconds for seconds, _ in runs) < 0.15


def test_version_is_one() -> None:
    assert importlib.metadata.version("orogen") == orogen.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(orogen.__version__)}\b", changes, flags=re.MULTILINE)


@pytest.mark.parametrize("command", [[sys.executable, "-m", "orogen"], [str(Path(sys.executable).parent / "orogen")]])
def test_command_tells_its_version(command: list[str]) -> None:
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
    assert orogen.__version__ in done.stdout


def test_wheel_is_whole(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    source = {path.relative_to(PACKAGE.parent).as_posix() for path in PACKAGE.rglob("*") if path.is_file()}
    source = {name for name in source if "__pycache__" not in name}
    assert "orogen/py.typed" in source
    assert source - packed == set()


def repository_files() -> list[Path]:
    """Files that are or would be committed."""
    listing = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(listing, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout: which files belong to the project is unknown")
    return [path for name in done.stdout.split("\0") if name and (path := ROOT / name).is_file()]


# Spelt so that this file does not hold what it forbids.
FORBIDDEN = {
    "a path of one machine": r"(?<![\w.$}])/(work|root|home|Users|opt)/\w|\b[A-Z]:\\\\?Users",
    "a package registry": r"(files\.python"
    + r"hosted|py"
    + r"pi\.(org|python)|conda\.ana"
    + r"conda|regis"
    + r"try\.npm)",
    "an address of a machine": r"(?<![\w.=])(?!127\.0\.0\.1|0\.0\.0\.0)\d{1,3}(\.\d{1,3}){3}(?![\w.])",
}


def test_text_is_clean() -> None:
    wrong = []
    for path in repository_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), start=1):
            for kind, pattern in FORBIDDEN.items():
                if re.search(pattern, line):
                    wrong.append(f"{path.relative_to(ROOT)}:{number} holds {kind}: {line.strip()[:100]}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("open('" + "/ho" + "me/ann/dem.tif')", "a path of one machine"),
        ("https://py" + "pi.org/simple", "a package registry"),
        ("http://10.1" + ".2.3/index", "an address of a machine"),
    ],
)
def test_unclean_text_is_found(line: str, kind: str) -> None:
    assert [name for name, pattern in FORBIDDEN.items() if re.search(pattern, line)] == [kind]


def test_constraints_are_names_and_versions() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    plain = re.compile(r'[a-z0-9-]+==[0-9][\w.]*( ; python_version (==|>=) "3\.\d+")?')
    assert [line for line in pins if not plain.fullmatch(line)] == []
    locks = {"uv.lock", "poetry.lock", "pdm.lock", "Pipfile.lock", "pylock.toml", "package-lock.json", "yarn.lock"}
    assert [path for path in repository_files() if path.name in locks] == []


def test_every_room_has_a_page() -> None:
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert packages - pages == set()
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert {page for page in pages - {"index"} if f"({page}.md)" not in index} == set()


def test_links_between_pages_hold() -> None:
    broken = []
    for page in [path for path in repository_files() if path.suffix == ".md"]:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", text):
            if "://" not in target and not target.startswith("mailto:") and not (page.parent / target).exists():
                broken.append(f"{page.relative_to(ROOT)} links to {target}")
    assert not broken, "\n".join(broken)
