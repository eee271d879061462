"""Files of a robot's model: MJCF or URDF, and the files that it refers to, mostly meshes.

All of them lie inside the robot's folder. Names are looked up as both formats do: in the directories that MJCF sets or
else beside the model, and as `package://NAME/path` inside the folder, which may itself be that package.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

from robots.errors import RobotError
from robots.files import read_file

TEXT_BYTES_MAX = 16 << 20
DEPTH_MAX = 200
"""Nesting of XML elements."""
ELEMENTS_MAX = 10_000
"""Number of XML elements: MuJoCo's time grows with the square of some, and a model is compiled several times."""
FILES_MAX, FILES_BYTES_MAX = 1000, 1 << 30
"""Number and total size of the files that a model refers to."""
COMPILERS_MAX = 10
"""Number of elements `compiler`: each may name directories in which every file is looked for."""
PACKAGE = "package://"
GENERATED_OR_EXTERNAL = ("include", "model", "attach", "replicate", "composite", "flexcomp")
"""Elements of MJCF whose parts come from another file, or are made when MuJoCo reads it: Pinocchio knows none."""


def is_urdf(model: Path) -> bool:
    """Return True if the file name ends in .urdf."""
    return model.suffix == ".urdf"


OWN = "firstshift/"
"""Beginning of the names of what this project adds to a model: payload, cable, floor, sensors."""


class _Builder(ElementTree.TreeBuilder):
    def doctype(self, name: str, *_: object) -> None:
        """Refuse declarations of entities: MuJoCo reads them in another way, and they may grow without bound."""
        raise ValueError(f"found <!DOCTYPE {name:.80}>, expected none")

    def start(self, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
        """Refuse names that this project gives to what it adds to a model."""
        if (name := attributes.get("name", "")).startswith(OWN):
            raise ValueError(f"found the name {name!r:.80}, expected none that begins with {OWN!r}")
        return super().start(tag, attributes)

    def start_ns(self, prefix: str, uri: str) -> None:
        """Refuse a default namespace, which MuJoCo ignores: elements would have other names here than there."""
        if not prefix:
            raise ValueError(f"found xmlns={uri!r:.80}, expected none")


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root of an XML file of bounded size, depth and elements, in UTF-8, names printable, no DOCTYPE.

    Raises:
        RobotError: the file breaks one of these bounds, or is no XML.
    """
    try:
        # MuJoCo reads UTF-8, whatever encoding the file declares.
        parser = ElementTree.XMLParser(target=_Builder(), encoding="utf-8")
        root = ElementTree.fromstring(read_file(path, TEXT_BYTES_MAX, RobotError), parser)
    except (ElementTree.ParseError, ValueError) as e:
        raise RobotError(f"{path}: not readable as XML: {e}") from e
    _check_elements(root, path)
    _check_names(root, path)
    return root


def _check_elements(root: ElementTree.Element, path: Path) -> None:
    """Bound the number of elements and their depth, through which others walk by recursion."""
    level, depth, count = [root], 0, 0
    while level:
        depth += 1
        count += len(level)
        if count > ELEMENTS_MAX:
            raise RobotError(f"{path}: found more than {ELEMENTS_MAX} elements, expected at most that")
        if depth > DEPTH_MAX:
            raise RobotError(f"{path}: found elements nested deeper than {DEPTH_MAX}, expected at most that")
        level = [child for element in level for child in element]


def _check_names(root: ElementTree.Element, path: Path) -> None:
    """Refuse names that are not printable: reports and terminals show those of shapes that collide."""
    for element in root.iter():
        if not (name := element.get("name", "")).isprintable():
            raise RobotError(
                f"{path}: {element.tag:.80}: found name {name!r:.80}, expected printable characters"
            )


def urdf_text(model: Path, folder: Path) -> str:
    """Return URDF that both libraries read alike: meshes by absolute path, no visuals, every link a body of its own.

    Raises:
        RobotError: it cannot be read, or a mesh is not inside the folder.
    """
    root = read_xml(model)
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(find_file(mesh.get("filename", ""), model, folder)[0]))
    for element in root.findall("mujoco"):
        root.remove(element)
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib |= {"strippath": "false", "fusestatic": "false"}
    return ElementTree.tostring(root, encoding="unicode")


def referenced_files(model: Path, folder: Path) -> tuple[Path, ...]:
    """Return the files that the model refers to, ordered by path; of URDF those of collision geometry.

    Raises:
        RobotError: a file cannot be read, is missing or not inside the folder, or they are too many or too large.
    """
    if is_urdf(model):
        meshes = read_xml(model).findall("link/collision/geometry/mesh")
        found = {find_file(mesh.get("filename", ""), model, folder)[0] for mesh in meshes}
    else:
        named = _named_by_mjcf(read_xml(model), model, folder)
        found = {path for _, _, paths in named for path in paths}
    if len(found) > FILES_MAX:
        raise RobotError(f"{model}: names {len(found)} files, expected at most {FILES_MAX}")
    size = sum(path.stat().st_size for path in found)
    if size > FILES_BYTES_MAX:
        raise RobotError(f"{model}: names files of {size} bytes, expected at most {FILES_BYTES_MAX}")
    return tuple(sorted(found))


def name_files_absolutely(root: ElementTree.Element, model: Path, folder: Path) -> None:
    """Write the paths of files into the root of MJCF that was read from `model`: it can be moved then.

    Raises:
        RobotError: as `referenced_files`.
    """
    for element, key, paths in _named_by_mjcf(root, model, folder):
        element.set(key, str(paths[0]))
    for compiler in root.iter("compiler"):
        compiler.attrib.pop("strippath", None)


def _named_by_mjcf(
    root: ElementTree.Element, model: Path, folder: Path
) -> list[tuple[ElementTree.Element, str, list[Path]]]:
    """Return elements that name files, the attribute that does, and the files on disk."""
    for element in root.iter():
        if element.tag in GENERATED_OR_EXTERNAL:
            raise RobotError(
                f"{model}: {element.tag}: found {' '.join(element.attrib.values())!r:.80}, expected a model in one"
                " file, all parts written out: Pinocchio reads no other"
            )
    compilers = [compiler.attrib for compiler in root.iter("compiler")]
    if len(compilers) > COMPILERS_MAX:
        raise RobotError(
            f"{model}: found {len(compilers)} elements compiler, expected at most {COMPILERS_MAX}"
        )
    stripped = {one["strippath"] for one in compilers if "strippath" in one} == {"true"}
    found, searched = [], dict[tuple[str, str], list[Path]]()
    for element, key, name in _names(root):
        kind = "texturedir" if element.tag == "texture" else "meshdir"
        if (name, kind) not in searched:
            if len(searched) == FILES_MAX:
                raise RobotError(f"{model}: names more than {FILES_MAX} files, expected at most that")
            places = [one[each] for one in compilers for each in ("assetdir", kind) if one.get(each)]
            for text in (name, *places):
                _check_no_space(text, model)
            file = Path(name).name if stripped else name
            searched[name, kind] = find_file(file, model, folder, places or [""])
        found.append((element, key, searched[name, kind]))
    return found


def _check_no_space(name: str, model: Path) -> None:
    """Refuse white space in the name of a file: Python's parser makes a space of each, MuJoCo's does not."""
    if name.split() != [name]:
        raise RobotError(f"{model}: file: found white space in {name!r:.200}, expected none")


def _names(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, str, str]]:
    for element in root.iter():
        yield from (
            (element, key, value) for key, value in element.items() if key.startswith("file") and value
        )


def find_file(name: str, model: Path, folder: Path, places: Sequence[str] = ("",)) -> list[Path]:
    """Return the files on disk that a library may take for a name in a model.

    `places` are the directories to search, relative to the model.

    Raises:
        RobotError: there is no such file, or a library would also search outside of the robot's folder.
    """
    if name.startswith(PACKAGE):
        rest = name.removeprefix(PACKAGE)
        tried = [folder / rest, folder / rest.partition("/")[2]]
    else:
        tried = [model.parent / place / name for place in places]
    tried = [Path(os.path.realpath(path)) for path in tried]
    inside = all(path.is_relative_to(folder.resolve()) for path in tried)
    if inside and (found := [path for path in tried if os.path.isfile(path)]):
        return found
    where = "there is none" if inside else "it is not inside"
    raise RobotError(f"{model}: file: found {name!r:.200}, expected a file inside {folder}: {where}")
