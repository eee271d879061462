import re
import struct

from support.paths import DATA
from support.robots.motors import DRIVES, declared

URDF = DATA / "two.urdf"
TETRAHEDRON = (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.2)
FACES = (0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)


def write_stl(path, points=TETRAHEDRON):
    """A tetrahedron in the binary form of STL."""
    path.parent.mkdir(parents=True, exist_ok=True)
    faces = [struct.pack("<12fH", 0, 0, 0, *(x for i in face for x in points[i]), 0) for face in FACES]
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(faces))


def two_links(folder, *, top="", edits=()):
    """A robot of two links that is URDF with a mesh: the arm's robot.toml with two joints and the arm's drives."""
    folder = declared(folder, {name: f"{text.rstrip()}\narmature = 0.1\n\n" for name, text in DRIVES.items()})
    (folder / "model.xml").unlink()
    write_stl(folder / "meshes" / "fore.stl")
    (folder / "two.urdf").write_text(URDF.read_text())
    path = folder / "robot.toml"
    head, shoulder, _, elbow, *_ = re.split(r"(?m)^(?=\[\[joints\]\])", path.read_text())
    shoulder, elbow = (
        shoulder.replace("shoulder_pan", "shoulder"),
        elbow.replace("q_max = 2.65", "q_max = 1.9"),
    )
    head = head.replace('tool = "tool"', f'model = "two.urdf"\ntool = "tip"\nlocked = ["grip"]\n{top}')
    text = head.replace('sites = ["tool"]', 'sites = ["tip"]') + shoulder + elbow
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    return folder


POST = (
    '<body name="post" pos="-0.55 -0.15 0.3">'
    '<geom name="post" type="capsule" fromto="0 0 -0.2 0 0 0.2" size="0.05"/>'
)
