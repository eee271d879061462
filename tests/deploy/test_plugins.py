import pytest

from deploy.plugins import BACKENDS, installed, load
from robots.errors import ConfigError


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a distribution with entry points of one group on the path; its module `name` holds `THING = name`."""

    def add(name, group, **entries):
        place = tmp_path / name
        info = place / f"{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (place / f"{name}.py").write_text(f"THING = {name!r}\n")
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        lines = "".join(f"{key} = {value}\n" for key, value in entries.items())
        (info / "entry_points.txt").write_text(f"[{group}]\n{lines}")
        monkeypatch.syspath_prepend(place)

    return add


def test_the_simulation_is_an_installed_backend():
    assert installed(BACKENDS)["sim"].module == "deploy.backends.sim.backend"


def test_a_plugin_is_found_by_name_and_imported_when_it_is_loaded(install):
    install("outside_plugin", "some.group", first="outside_plugin:THING", second="nowhere:NOTHING")
    assert list(installed("some.group")) == ["first", "second"]
    assert load("some.group", "first", "--thing first") == "outside_plugin"


def test_an_unknown_name_lists_the_known_ones(install):
    install("listed_plugin", "some.group", b="listed_plugin:THING", a="listed_plugin:THING")
    with pytest.raises(ConfigError, match=r"^--thing c: unknown; known: a, b$"):
        load("some.group", "c", "--thing c")


@pytest.mark.parametrize("value", ["nowhere_at_all:THING", "broken_plugin:OTHER"])
def test_a_plugin_that_cannot_be_imported_is_an_error_with_its_place(install, value):
    install("broken_plugin", "some.group", a=value)
    with pytest.raises(ConfigError, match=f"^--thing a: {value.partition(':')[0]} cannot be imported: "):
        load("some.group", "a", "--thing a")


def test_one_name_of_two_distributions_is_an_error(install):
    install("one_plugin", "some.group", a="one_plugin:THING")
    install("other_plugin", "some.group", a="other_plugin:THING")
    with pytest.raises(ConfigError, match=r"^some\.group: a: found one_plugin:THING and other_plugin:THING$"):
        installed("some.group")
