"""Command robot-init: create a robot folder from a vendor's model."""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tomlkit
import typer

from deploy.command_line import PASSED, main
from policies.robot_init.permanent_contacts import permanent_contacts
from policies.robot_init.robot_files import draws_toml, limits_toml, robot_toml
from policies.robot_init.vendor_model import VendorModel, read_vendor_model
from robots.errors import OutputError, RobotError, is_utf8, output_error, printable
from robots.models.files import is_urdf, referenced_files
from robots.models.sandbox import check_compiles
from robots.strict import ROBOT_NAME, placeholder_fields

WALKS = typer.Option("--walks", help="the base is free (floating); for URDF, which cannot express it")
SUFFIXES = (".xml", ".urdf")
README = """# {name}

{joints} actuated joints, from the vendor's unchanged `{model}`.

| file | contents |
|---|---|
| `{model}` | links, inertias, mechanical ranges, shapes |
| `robot.toml` | rates, working ranges, margins, sensors, motors and their drives |
| `draws.toml` | variation between real robots: the ranges of arm6, all estimates here |
| `limits.toml` | limits checked by the judge of a soak |

## Where the numbers come from
Fill in every "?", name the source of each number, and list the estimates here.
"""


def init_robot(model: Path, out: Path, *, walks: bool = False) -> tuple[VendorModel, list[tuple[str, str]]]:
    """Write a robot folder; return the model's properties and the open fields as (table, key).

    Args:
        model: MJCF or URDF. out: the folder.
        walks: True for a floating base without a free joint, as in URDF.

    Raises:
        RobotError: the model is unreadable or too large, or names files outside of its folder.
        OutputError: the folder exists, cannot be written, or has a name that no robot can have.
    """
    folder, name = package_of(model), Path(os.path.normpath(out)).name
    if not re.fullmatch(ROBOT_NAME, name):
        raise OutputError(f"--out {out}: found name {name!r}, expected up to 64 letters, digits, - and _")
    vendor = _read_robot(model, folder, walks=walks)
    files = [model.resolve(), *referenced_files(model, folder)]
    model_path = model.resolve().relative_to(folder).as_posix()
    pairs = dict.fromkeys((*vendor.neighbours, *permanent_contacts(model, folder, vendor)))
    tables = {
        "robot.toml": robot_toml(vendor, name, model_path, tuple(pairs)),
        "draws.toml": draws_toml(vendor),
        "limits.toml": limits_toml(vendor, name),
    }
    texts = {file: tomlkit.dumps(table) for file, table in tables.items()}
    texts["README.md"] = README.format(name=name, model=model_path, joints=len(vendor.driven))
    _write(out, files, folder, texts)
    return vendor, [field for file, table in tables.items() for field in _still_open(file, table)]


def _read_robot(model: Path, folder: Path, *, walks: bool) -> VendorModel:
    check_compiles(model, folder)
    vendor = read_vendor_model(model, folder)
    if walks and not is_urdf(model) and not vendor.floating_base:
        raise RobotError(f"{model}: found no free joint, expected one: --walks is for URDF only")
    if not vendor.joints:
        raise RobotError(f"{model}: found no joint, expected at least one")
    return replace(vendor, floating_base=vendor.floating_base or walks)


def _still_open(file: str, document: tomlkit.TOMLDocument) -> Iterator[tuple[str, str]]:
    for field in placeholder_fields(document.unwrap()):
        table, _, key = field.rpartition(".")
        yield f"{file} {table}".rstrip(), key


def package_of(model: Path) -> Path:
    """Return the folder that the model's files must be in: the ROS package of a URDF, or the model's own folder.

    Raises:
        RobotError: the path is no model, or its name or that of a folder above it is not UTF-8.
    """
    is_file = os.path.isfile(model)
    if not is_file or model.suffix not in SUFFIXES:
        found = "a folder" if os.path.isdir(model) else "another kind of file" if is_file else "no file"
        raise RobotError(f"{model}: found {found}, expected a model: MJCF (.xml) or URDF (.urdf)")
    if not is_utf8(path := str(model.resolve())):
        raise RobotError(f"{path}: found a name that is not UTF-8")
    parents = model.resolve().parents
    packages = (
        [parent for parent in parents if os.path.isfile(parent / "package.xml")] if is_urdf(model) else []
    )
    return packages[0] if packages else parents[0]


def _write(out: Path, files: list[Path], folder: Path, texts: dict[str, str]) -> None:
    """Write the robot folder, whole or not at all."""
    if not is_utf8(str(out)):
        raise OutputError(f"--out {out}: found a name that is not UTF-8")
    _check_new(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".", dir=out.parent) as temporary:
            partial = Path(temporary, "robot")  # of the usual permissions, unlike `temporary`
            for path in files:
                copy = partial / path.relative_to(folder)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy)
            for name, text in texts.items():
                (partial / name).write_text(text, encoding="utf-8")
            partial.rename(out)
    except OSError as e:
        _check_new(out)  # another process may have written it in the meantime
        raise output_error(f"--out {out}: cannot be written: {e.strerror}", e) from e


def _check_new(out: Path) -> None:
    if os.path.lexists(out):
        raise OutputError(f"--out {out}: exists already, expected another path, or remove it first")


def robot_init(
    model: Annotated[Path, typer.Argument(help="the vendor's MJCF (.xml) or URDF (.urdf)")],
    out: Annotated[Path | None, typer.Option(help="folder to write", show_default="out/<model>")] = None,
    walks: Annotated[bool, WALKS] = False,
) -> int:
    """Create a robot folder from a vendor's model: known values, estimates marked as such, and "?" for the rest."""
    folder = out or Path("out", model.stem)
    vendor, still_open = init_robot(model, folder, walks=walks)
    counts = f"{len(vendor.joints)} joints, {len(vendor.locked)} of them locked, {len(vendor.shapes)} shapes"
    print(printable(f"{folder}: {counts}"))
    if vendor.floating_base:
        print("floating base: a walking robot without tool")
    print(f"{len(still_open)} fields to fill in:", *_grouped(still_open), sep="\n")
    return PASSED


def _grouped(still_open: list[tuple[str, str]]) -> Iterator[str]:
    """Yield one line for all tables of a kind with the same open keys."""
    keys: dict[str, list[str]] = {}
    for table, key in still_open:
        keys.setdefault(table, []).append(key)
    groups: dict[tuple[str, str], list[str]] = {}
    for table, open_keys in keys.items():
        kind, dot, name = table.rpartition(".")
        groups.setdefault((kind + dot, ", ".join(open_keys)), []).append(name)
    for (kind, missing), names in groups.items():
        yield f"  {kind}{', '.join(names)}: {missing}"


def cli() -> None:
    """Entry point of `robot-init`."""
    main(robot_init)
