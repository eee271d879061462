"""robot-init: a vendor's model becomes a robot folder, filled in as far as the model says."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tomlkit
import typer

from deploy.command_line import PASSED, main
from policies.robot_init.permanent_contacts import always_near
from policies.robot_init.robot_files import draws_toml, limits_toml, robot_toml
from policies.robot_init.vendor_model import Facts, read_facts
from robots.errors import OutputError, RobotError
from robots.models.files import is_urdf, referenced_files
from robots.models.sandbox import check_compiles
from robots.strict import placeholder_fields

SUFFIXES = (".xml", ".urdf")
README = """# {name}

{joints} joints that are driven, from `{model}`, which is the vendor's and unchanged.

| file | says |
|---|---|
| `{model}` | links, inertias, mechanical ranges, shapes |
| `robot.toml` | rates, working ranges, margins, sensors, motors and their drives |
| `draws.toml` | how a robot of this kind may really be: the ranges of arm6, all of them estimates here |
| `limits.toml` | what the judge of a soak holds it to |

## Where the numbers come from
Fill in every "?", name the source of each number, and say here what is an estimate.
"""


def init_robot(model: Path, out: Path, *, walks: bool = False) -> tuple[Facts, list[tuple[str, str]]]:
    """Write a robot folder; returns what the model says, and the fields that are still open: table and key.

    Args:
        model: MJCF or URDF. out: the folder.
        walks: whether its base is free although it has no free joint, as in URDF.

    Raises:
        RobotError: the model cannot be read within bounds, or it names files outside of its folder.
        OutputError: the folder is there already, or cannot be written.
    """
    folder = package_of(model)
    check_compiles(model, folder)
    files = [model.resolve(), *referenced_files(model, folder)]
    facts = read_facts(model, folder)
    if walks and not is_urdf(model) and not facts.floats:
        raise RobotError(f"{model}: found no free joint, expected one: only URDF has no words for it")
    facts = replace(facts, floats=facts.floats or walks)
    if not facts.joints:
        raise RobotError(f"{model}: has no hinge, expected a robot with joints")
    place = model.resolve().relative_to(folder).as_posix()
    pairs = dict.fromkeys((*facts.neighbours, *always_near(model, folder, facts)))
    name = out.resolve().name
    tables = {
        "robot.toml": robot_toml(facts, name, place, tuple(pairs)),
        "draws.toml": draws_toml(facts),
        "limits.toml": limits_toml(facts, name),
    }
    readme = README.format(name=name, model=place, joints=len(facts.joints) - len(facts.locked))
    texts = {file: tomlkit.dumps(table) for file, table in tables.items()} | {"README.md": readme}
    _write(out, files, folder, texts)
    return facts, [field for file, table in tables.items() for field in _still_open(file, table)]


def _still_open(file: str, document: tomlkit.TOMLDocument) -> Iterator[tuple[str, str]]:
    for field in placeholder_fields(document.unwrap()):
        table, _, key = field.rpartition(".")
        yield f"{file} {table}".rstrip(), key


def package_of(model: Path) -> Path:
    """The folder whose files a model may name: the ROS package that URDF lies in, or the one beside the model.

    Raises:
        RobotError: there is none.
    """
    if not model.is_file() or model.suffix not in SUFFIXES:
        found = "a folder" if model.is_dir() else "another kind of file" if model.is_file() else "no file"
        raise RobotError(f"{model}: found {found}, expected a model: MJCF (.xml) or URDF (.urdf)")
    parents = model.resolve().parents
    packages = [parent for parent in parents if (parent / "package.xml").is_file()] if is_urdf(model) else []
    return packages[0] if packages else parents[0]


def _write(out: Path, files: list[Path], folder: Path, texts: dict[str, str]) -> None:
    if out.exists():
        raise OutputError(f"--out {out}: is there already, expected another place, or to remove it first")
    try:
        for path in files:
            copy = out / path.relative_to(folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
        for name, text in texts.items():
            (out / name).write_text(text, encoding="utf-8")
    except OSError as e:
        raise OutputError(f"--out {out}: cannot be written: {e.strerror}") from e


def robot_init(
    model: Annotated[Path, typer.Argument(help="the vendor's MJCF (.xml) or URDF (.urdf)")],
    out: Annotated[Path | None, typer.Option(help="folder to write", show_default="out/<model>")] = None,
    walks: Annotated[bool, typer.Option("--walks", help="its base is free, which URDF cannot say")] = False,
) -> int:
    """Make a robot folder of a vendor's model: all that it says, estimates that say so, and "?" for the rest."""
    place = out or Path("out", model.stem)
    facts, still_open = init_robot(model, place, walks=walks)
    print(
        f"{place}: {len(facts.joints)} joints, {len(facts.locked)} of them locked, {len(facts.shapes)} shapes"
    )
    if facts.floats:
        print("its base is free: it walks, and has no tool")
    print(f"{len(still_open)} fields are still to be filled in:")
    print("\n".join(_gathered(still_open)))
    return PASSED


def _gathered(still_open: list[tuple[str, str]]) -> Iterator[str]:
    """A line for all tables of one kind that lack the same."""
    keys: dict[str, list[str]] = {}
    for table, key in still_open:
        keys.setdefault(table, []).append(key)
    alike: dict[tuple[str, str], list[str]] = {}
    for table, open_keys in keys.items():
        kind, dot, name = table.rpartition(".")
        alike.setdefault((kind + dot, ", ".join(open_keys)), []).append(name)
    for (kind, lacking), names in alike.items():
        yield f"  {kind}{', '.join(names)}: {lacking}"


def cli() -> None:
    """Entry point of `robot-init`."""
    main(robot_init)
