"""Files: only regular ones of a sensible size are read; a file is written whole or not at all, and never through a link."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mfc_analysis.maths import files

posix = pytest.mark.skipif(os.name == "nt", reason="pipes, devices and links of POSIX")


def test_a_file_is_read_whole_up_to_its_largest_size(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert files.read(path, 5) == b"12345"
    with pytest.raises(OSError, match=r"larger than 4e-06 MB") as info:
        files.read(path, 4)
    assert info.value.filename == str(path)


@posix
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe", tmp_path / "link", Path("/dev/zero")):
        with pytest.raises(OSError, match="not a regular file"):
            files.read(path, 100)
    with pytest.raises(IsADirectoryError):
        files.read(tmp_path, 100)
    with pytest.raises(FileNotFoundError):
        files.read(tmp_path / "none", 100)


@posix
def test_a_link_is_replaced_and_its_target_is_unchanged(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("precious")
    for name, target in (("link", "target"), ("dangling", "nowhere")):
        (tmp_path / name).symlink_to(target)
        files.write(tmp_path / name, b"new")
        assert not (tmp_path / name).is_symlink() and (tmp_path / name).read_bytes() == b"new"
    assert (tmp_path / "target").read_text() == "precious" and not (tmp_path / "nowhere").exists()


@posix
def test_a_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").write_bytes(b"")
    files.write(tmp_path / "made", b"")
    assert stat.S_IMODE((tmp_path / "made").stat().st_mode) == stat.S_IMODE((tmp_path / "usual").stat().st_mode)


def test_a_failed_write_names_the_file_and_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "page.html"
    path.write_bytes(b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as info:
        files.write(path, b"new")
    assert info.value.filename == str(path) and path.read_bytes() == b"old" and [p.name for p in tmp_path.iterdir()] == ["page.html"]


@posix
def test_a_limit_on_the_size_of_files_leaves_none(tmp_path: Path) -> None:
    code = "import resource; from pathlib import Path; from mfc_analysis.maths import files\n"
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    code += f"files.write(Path({str(tmp_path / 'a')!r}), b'x' * 5000)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "File too large" in done.stderr and not list(tmp_path.iterdir())


@posix
def test_a_folder_a_pipe_or_a_link_to_one_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("folder", "pipe", "link"):
        with pytest.raises(OSError, match="not a regular file") as info:
            files.write(tmp_path / name, b"new")
        assert info.value.filename == str(tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "link", "pipe"] and (tmp_path / "link").is_symlink()
