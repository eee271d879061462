import fcntl
import os


def made_once(tmp_path_factory, name, make):
    """Folder `name` that `make(folder)` fills once for all processes of a test run; nobody may change it.

    The processes of pytest-xdist have temporary folders side by side; the first one to need the folder makes it.
    """
    root = tmp_path_factory.getbasetemp()
    folder = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / f"shared-{name}"
    folder.mkdir(exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / ".made").exists():
            make(folder)
            (folder / ".made").touch()
    return folder
