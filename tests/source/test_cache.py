"""The cache folder: where it is, its budget, and what may be removed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orogen.errors import SettingsError
from orogen.source import cache


def entry(folder: Path, name: str, size: int, used: float) -> Path:
    path = folder / name
    path.mkdir(parents=True)
    (path / "data").write_bytes(bytes(size))
    (path / cache.MARK).touch()
    os.utime(path / cache.MARK, (used, used))
    return path


def test_the_folder_is_the_variable_or_the_platform_s(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "here"))
    assert cache.cache_dir() == tmp_path / "here"
    monkeypatch.delenv("OROGEN_CACHE_DIR")
    assert cache.cache_dir().name == "orogen"


@pytest.mark.parametrize(
    ("text", "size"),
    [("", 20 * 10**9), ("123", 123), ("500MB", 500 * 10**6), ("1.5 g", 15 * 10**8), ("2T", 2 * 10**12)],
)
def test_the_budget_is_a_size(monkeypatch: pytest.MonkeyPatch, text: str, size: int) -> None:
    monkeypatch.setenv("OROGEN_CACHE_MAX", text)
    assert cache.cache_max() == size


def test_a_budget_that_is_no_size_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_MAX", "lots")
    with pytest.raises(SettingsError, match="OROGEN_CACHE_MAX: expected a size such as 500MB or 20GB, got 'lots'"):
        cache.cache_max()


def test_info_lists_the_least_recently_used_first(tmp_path: Path) -> None:
    entry(tmp_path, "new", 10, 2000)
    entry(tmp_path, "old", 20, 1000)
    found = cache.info(tmp_path)
    assert [(e.path.name, e.size, e.used) for e in found.entries] == [("old", 20, 1000), ("new", 10, 2000)]
    assert found.size == 30
    assert cache.info(tmp_path / "nowhere").entries == []


def test_clear_keeps_what_is_in_use(tmp_path: Path) -> None:
    used, free = entry(tmp_path, "used", 10, 1), entry(tmp_path, "free", 20, 2)
    with cache.hold(used) or pytest.fail("not held"):
        assert cache.clear(tmp_path) == 20
        assert used.exists()
    assert not free.exists()
    assert cache.clear(tmp_path) == 10
    assert not list(tmp_path.iterdir())


def test_tidy_removes_the_least_recently_used_beyond_the_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OROGEN_CACHE_MAX", "55")
    for number, name in enumerate("abcd"):
        entry(tmp_path, name, 20, 1000 + number)
    with cache.hold(tmp_path / "b") or pytest.fail("not held"):  # now the most recently used, and in use
        cache.tidy(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b", "d"]


def test_using_an_entry_renews_it(tmp_path: Path) -> None:
    mark = cache.hold(entry(tmp_path, "a", 1, 1000))
    assert mark is not None
    mark.close()
    assert cache.info(tmp_path).entries[0].used > 1e9
    assert cache.hold(tmp_path / "nothing") is None


def test_a_build_appears_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "entry"
    with cache.building(target) as draft:
        (draft / "data").write_text("new")
        cache.tidy(tmp_path)  # must not take the draft away
        assert not target.exists()
    assert (target / "data").read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["entry"]


def test_a_build_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), cache.building(tmp_path / "entry"):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_the_quicker_of_two_builds_stays(tmp_path: Path) -> None:
    target = tmp_path / "entry"
    with cache.building(target) as slow:
        (slow / "data").write_text("slow")
        with cache.building(target) as quick:
            (quick / "data").write_text("quick")
    assert (target / "data").read_text() == "quick"
    assert [p.name for p in tmp_path.iterdir()] == ["entry"]


def test_tidy_removes_what_a_killed_build_left(tmp_path: Path) -> None:
    entry(tmp_path, f"entry{cache.BUILDING}123", 10, 1)
    cache.tidy(tmp_path)
    assert not list(tmp_path.iterdir())


def test_folders_that_are_not_entries_are_never_removed(tmp_path):
    stranger = tmp_path / "photos"
    stranger.mkdir()
    (stranger / "holiday.jpg").write_bytes(b"precious")
    assert not cache.info(tmp_path).entries
    assert cache.clear(tmp_path) == 0
    assert not cache.remove(stranger)
    assert (stranger / "holiday.jpg").read_bytes() == b"precious"
