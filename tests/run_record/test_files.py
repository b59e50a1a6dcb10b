"""What becomes of a file that is written, of links to it, and of what is no file."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.run_record.files import write_asked_for, write_atomically

NULL = os.makedev(1, 3)


def test_a_file_that_is_replaced_keeps_its_permissions_and_a_new_one_has_the_umask_s(tmp_path: Path) -> None:
    old = tmp_path / "old"
    old.write_text("long before")
    old.chmod(0o640)
    write_atomically(old, "new")
    assert (old.read_text(), stat.S_IMODE(old.stat().st_mode)) == ("new", 0o640)
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "new", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "old"]


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_is_followed_over_any_number_of_links(tmp_path: Path, is_there: bool) -> None:
    (tmp_path / "folder").mkdir()
    target = tmp_path / "folder" / "target"
    if is_there:
        target.write_text("before")
    (tmp_path / "folder" / "inner").symlink_to("target")
    (tmp_path / "outer").symlink_to("folder/inner")
    write_atomically(tmp_path / "outer", "new")
    assert (tmp_path / "outer").is_symlink()
    assert (tmp_path / "folder" / "inner").is_symlink()
    assert target.read_text() == "new"
    assert sorted(path.name for path in target.parent.iterdir()) == ["inner", "target"]


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(ConfigError, match=r"cannot write .*a: Too many levels of symbolic links; name another file"):
        write_asked_for(tmp_path / "a", "new")


def test_a_pipe_gets_the_text_and_stays_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got: list[str] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()), daemon=True)
    reader.start()
    write_atomically(pipe, "text")
    reader.join(timeout=10.0)
    assert got == ["text"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize("through_link", [False, True])
def test_a_device_stays_a_device(tmp_path: Path, through_link: bool) -> None:
    device = tmp_path / "null"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, NULL)
    except PermissionError:  # who may not make a device may not replace /dev/null either
        device.symlink_to("/dev/null")
    (tmp_path / "link").symlink_to(device)
    write_atomically(tmp_path / ("link" if through_link else "null"), "text")
    assert stat.S_ISCHR(device.stat().st_mode)
    assert device.stat().st_rdev == NULL


def test_standard_output_is_written_to_where_the_shell_opened_it(tmp_path: Path) -> None:
    program = (
        "from pathlib import Path; from hiltest.run_record.files import write_atomically;"
        "print('before', flush=True); write_atomically(Path('/dev/stdout'), 'text'); print('after')"
    )
    with (tmp_path / "out").open("ab") as out:
        subprocess.run([sys.executable, "-c", program], stdout=out, check=True, timeout=60)
    assert (tmp_path / "out").read_text() == "before\ntextafter\n"


@pytest.mark.parametrize(
    ("name", "reason"), [("gone/file", "No such file"), ("a\0b", "null byte"), ("x" * 300, "name too long")]
)
def test_a_name_that_cannot_be_written_is_refused(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=f"cannot write .*{reason}"):
        write_asked_for(tmp_path / name, "text")
