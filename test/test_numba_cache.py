"""Compiled code where neither the installation nor the home can be written."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import hyst_control
from hyst_control.base import numba_cache

CODE = "import os, hyst_control.chain; print(os.environ['NUMBA_CACHE_DIR'])"


def test_a_read_only_installation_and_home_use_a_temporary_cache(tmp_path):
    """Files stand where the caches would be, which stops root as well as a user."""
    package = tmp_path / "site" / "hyst_control"
    shutil.copytree(Path(hyst_control.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [package, *(path for path in package.rglob("*") if path.is_dir())]:
        (folder / "__pycache__").touch()
    (tmp_path / "home").touch()
    (tmp_path / "tmp").mkdir()
    kept = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment = {**kept, "HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run([sys.executable, "-c", CODE], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.strip())
    assert folder.parent == tmp_path / "tmp" and folder.stat().st_mode & 0o777 == 0o700
    assert done.stderr.count("\n") == 1 and str(folder) in done.stderr


def test_a_folder_that_others_can_write_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(numba_cache.tempfile, "tempdir", str(tmp_path))
    expected = tmp_path / f"hyst_control-numba-{os.getuid()}"
    assert numba_cache._own_folder() == str(expected) == numba_cache._own_folder()
    expected.chmod(0o777)
    other = Path(numba_cache._own_folder())
    assert other != expected and other.stat().st_mode & 0o777 == 0o700
    expected.rmdir()
    expected.symlink_to(other)
    assert numba_cache._own_folder() not in (str(expected), str(other))
