"""Programs that no wheel brings: a missing one is installed, or named, or a failure, but never passed over."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import toolchains
from tests.patience import PATIENCE_S

PROJECT = Path(__file__).resolve().parents[1]
SCRIPT = PROJECT / "tools" / "toolchains.sh"
NODE_SCRIPT = PROJECT / "tools" / "node_packages.sh"
NEEDED = ("bash", "cat", "chmod", "cmp", "cp", "dirname", "env", "mkdir", "sort", "timeout", "touch", "tr")


class Machine:
    """A PATH of its own: what the script itself uses, an `id`, perhaps an `apt-get` that notes its arguments."""

    def __init__(self, folder: Path, tools: tuple[str, ...], root: bool, apt: str | None) -> None:
        self.bin = folder / "bin"
        self.bin.mkdir()
        self.calls = folder / "calls"
        for name in NEEDED:
            (self.bin / name).symlink_to(shutil.which(name) or name)
        self.write("id", f"echo {0 if root else 1000}")
        for name in tools:
            self.write(name, f"echo {SCRIPT}")  # to -print-file-name: a file that is there
        if apt is not None:
            self.write("apt-get", f'echo "$@" >> {self.calls}\n{apt}')

    def write(self, name: str, body: str) -> None:
        file = self.bin / name
        file.write_text(f"#!{shutil.which('bash')}\n{body}\n")
        file.chmod(0o755)

    def run(self, *command: Path, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(self.bin / "bash"), *map(str, command or [SCRIPT])],
            env={"PATH": str(self.bin), **environment},
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )


ALL = tuple(toolchains.PACKAGES)


def test_with_everything_there_nothing_is_asked_of_apt(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ALL, root=True, apt="exit 1")
    done = machine.run(CI="true")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not machine.calls.exists()


def test_root_on_debian_gets_what_is_missing(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ALL[:-1], root=True, apt="")
    program = machine.bin / "qemu-system-arm"
    machine.write("apt-get", f'echo "$@" >> {machine.calls}\ntouch {program}; chmod +x {program}')
    done = machine.run(TWODOF_REQUIRE_TOOLS="1")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "tools: installing qemu-system-arm\n"
    waits = "-o DPkg::Lock::Timeout=300 -o Acquire::Retries=3"  # for who else installs, and for a mirror
    assert machine.calls.read_text().splitlines() == [
        f"{waits} update -qq",
        f"{waits} install -y -qq --no-install-recommends qemu-system-arm",
    ]


@pytest.mark.parametrize(("root", "apt"), [(False, "exit 0"), (True, None), (True, "exit 1")])
def test_what_cannot_be_installed_is_named_in_one_line(root: bool, apt: str | None, tmp_path: Path) -> None:
    machine = Machine(tmp_path, ("gcc", "g++", "node", "npm", "chromium", "cppcheck", "octave-cli", "curl"), root, apt)
    done = machine.run()
    assert done.returncode == 0
    assert done.stderr.splitlines()[-1] == (
        "tools: qemu-system-arm, arm-none-eabi-gcc missing: the tests that need them will be skipped; "
        "install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
    )
    for environment in ({"CI": "true"}, {"TWODOF_REQUIRE_TOOLS": "1"}):
        refused = machine.run(**environment)
        assert refused.returncode == 1
        assert "qemu-system-arm, arm-none-eabi-gcc missing, and nothing may be skipped here" in refused.stderr


def test_a_missing_newlib_is_found(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ALL, root=False, apt=None)
    machine.write("arm-none-eabi-gcc", "echo libm.a")  # what the compiler says where the library is not
    assert "install libnewlib-arm-none-eabi" in machine.run().stderr


def test_the_tests_know_the_same_tools_and_packages() -> None:
    script = SCRIPT.read_text()
    for program, packages in toolchains.PACKAGES.items():
        assert f'"{program} {packages}"' in script


def test_a_test_is_skipped_with_the_package_or_fails_where_nothing_may_be_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setenv("TWODOF_REQUIRE_TOOLS", "0")
    with pytest.raises(pytest.skip.Exception, match="node is missing: `make tools` as root, or install nodejs"):
        toolchains.need("node")
    monkeypatch.setenv("TWODOF_REQUIRE_TOOLS", "1")
    with pytest.raises(pytest.fail.Exception, match="install nodejs"):
        toolchains.need("node")


def test_node_packages_are_installed_once(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ("node",), root=False, apt=None)
    machine.write("npm", f'echo "$@" >> {machine.calls}')
    first, second = (machine.run(NODE_SCRIPT, tmp_path / "node", CI="true") for _ in range(2))
    assert (first.returncode, first.stderr, second.returncode, second.stdout) == (0, "", 0, "")
    assert len(machine.calls.read_text().splitlines()) == 1


@pytest.mark.parametrize(("npm", "reason"), [(None, "npm is missing"), ("exit 1", "npm could not install it")])
def test_node_packages_that_cannot_be_installed_are_named(npm: str | None, reason: str, tmp_path: Path) -> None:
    machine = Machine(tmp_path, ("node",), root=False, apt=None)
    if npm is not None:
        machine.write("npm", npm)
    done = machine.run(NODE_SCRIPT, tmp_path / "node")
    assert done.returncode == 0
    assert done.stderr == f"tools: node-mavlink missing ({reason}): the tests that need it will be skipped\n"
    refused = machine.run(NODE_SCRIPT, tmp_path / "node", CI="true")
    assert refused.returncode == 1
    assert f"({reason}), and nothing may be skipped here" in refused.stderr


def test_a_missing_node_package_skips_or_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchains, "need", lambda *programs: None)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setenv("TWODOF_REQUIRE_TOOLS", "0")
    with pytest.raises(pytest.skip.Exception, match="node-mavlink is missing: `make tools`"):
        toolchains.need_node_package("node-mavlink")
    monkeypatch.setenv("TWODOF_REQUIRE_TOOLS", "1")
    with pytest.raises(pytest.fail.Exception, match="node-mavlink is missing"):
        toolchains.need_node_package("node-mavlink")


def test_continuous_integration_requires_the_tools() -> None:
    assert "export TWODOF_REQUIRE_TOOLS=1" in (PROJECT / ".ci" / "run").read_text()


@pytest.mark.parametrize("target", ["web", "demo", "play", "check"])
def test_make_works_in_a_folder_with_spaces(tmp_path: Path, target: str) -> None:
    folder = tmp_path / "My Drive - Università"
    machine = Machine(tmp_path, ("make",), root=False, apt=None)
    for name in ("tools/web.sh", ".venv/bin/python", ".venv/bin/twodof", ".venv/bin/ruff", ".venv/bin/mypy"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        machine.write("script", 'echo "$#|$1|$2" >> "$CALLS"')
        shutil.move(machine.bin / "script", folder / name)
    shutil.copy(PROJECT / "Makefile", folder)
    made = [arg for name in ("run", "sandbox", "dev") for arg in ("-o", f".venv/ready-{name}")]
    command = ["make", "-C", str(folder), *made, target]
    environment = {**os.environ, "CALLS": str(machine.calls)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    step = "build" if target in ("web", "demo") else target
    assert f"2|{folder}/.venv/bin/python|{step}" in machine.calls.read_text().splitlines()


def test_building_the_page_follows_no_link_outside(tmp_path: Path) -> None:
    """Anybody may lay a link into the temporary folder: opening it for a lock would empty the file behind it."""
    web, shared, kept = tmp_path / "web", tmp_path / "shared", tmp_path / "kept"
    (web / "node_modules").mkdir(parents=True)
    (tmp_path / "tools").mkdir()
    shared.mkdir()
    shutil.copy(PROJECT / "tools" / "web.sh", tmp_path / "tools")
    for place in ("package-lock.json", "node_modules/installed-lock.json"):
        (web / place).write_text("{}")
    kept.write_text("mine")
    mark = hashlib.sha256(f"{web}\n".encode()).hexdigest()[:16]
    (shared / f"twodof-web-{mark}.lock").symlink_to(kept)
    machine = Machine(tmp_path, (), root=False, apt=None)
    for name in ("node", "npm", "npx"):
        machine.write(name, "exit 0")
    environment = {**os.environ, "PATH": f"{machine.bin}:{os.environ['PATH']}", "TMPDIR": str(shared)}
    command = ["bash", str(tmp_path / "tools" / "web.sh"), sys.executable, "test"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr, kept.read_text()) == (0, "", "mine")
    assert len([*shared.iterdir()]) == 1
