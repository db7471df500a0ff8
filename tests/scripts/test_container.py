"""The container file: it takes all that the wheel is made of, and the context holds it."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONTAINER = (ROOT / "Containerfile").read_text(encoding="utf-8")


def copied() -> set[str]:
    """Return what the container file takes from the repository."""
    lines = re.findall(r"^COPY (?!--from)(.*) \S+$", CONTAINER, flags=re.MULTILINE)
    return {name for line in lines for name in line.split()}


def test_the_image_is_made_of_all_that_the_wheel_needs():
    """The package, what is put into it, and the files that pyproject.toml names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {"pyproject.toml", project["project"]["readme"], *project["project"]["license-files"]}
    needed |= {*wheel["packages"], *wheel["force-include"], wheel["hooks"]["custom"]["path"], "scripts"}
    assert needed <= copied()


def test_the_context_holds_what_is_copied():
    """Each is in the repository, and is let in by .dockerignore, which lets in nothing else."""
    ignored, *allowed, _ = [
        line for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if not line.startswith("#")
    ]
    assert ignored == "*"
    assert {line.removeprefix("!") for line in allowed} == copied()
    assert all((ROOT / name).exists() for name in copied())


def test_the_readme_names_the_commands_of_the_container_file():
    """Both pages have the same lines."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    run = 'podman run --rm -v "$PWD:/data"'
    served = f"{run} -p 127.0.0.1:8080:8080 msbdb serve town.sqlite --host 0.0.0.0"
    for command in ("podman build -t msbdb .", f"{run} msbdb build --points town.laz", served):
        assert command in CONTAINER
        assert command in readme


def test_the_image_has_every_extra_that_a_command_needs():
    """All that pyproject.toml offers, but those for the work on msbdb itself: so that no command asks for pip."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    [installed] = re.findall(r'pip install .*"\.\[(.*)\]"', CONTAINER)
    assert set(installed.split(",")) == set(extras) - {"test", "guide", "lint"}
