"""Files of GitHub: they are valid, the site has least permissions, steps of the action run."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from junitparser import JUnitXml

from tests.conftest import write_noise, write_plugin

ROOT = Path(__file__).parents[1]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
STEPS = ACTION["runs"]["steps"]
SHELL_STEPS = {step["name"]: step for step in STEPS if "run" in step}
HOW_TO = (ROOT / "docs" / "how-to" / "regress-in-ci.md").read_text()
(WORKFLOW,) = re.findall(r"```yaml\n(.*?)```", HOW_TO, re.DOTALL)
EXPRESSION = re.compile(r"\$\{\{ *([\w.()!-]+) *\}\}")
RUNNER = (
    *("runner.os", "runner.arch", "runner.temp"),
    *("github.action_path", "github.action_ref", "!cancelled()"),
)
WORKFLOWS = {file.name: file.read_text() for file in (ROOT / ".github/workflows").glob("*.yml")}
SITE = yaml.safe_load(WORKFLOWS["site.yml"])
CHECKED = [
    ("github-actions", (ROOT / "action.yml").read_text()),
    *(("github-workflows", text) for text in (WORKFLOW, *WORKFLOWS.values())),
]


@pytest.mark.parametrize(("schema", "text"), CHECKED, ids=["action", "example", *WORKFLOWS])
def test_files_are_valid_by_the_published_schemas(schema, text, tmp_path):
    """The schemas are those of schemastore.org, as check-jsonschema ships them."""
    (tmp_path / "checked.yml").write_text(text)
    words = ("--builtin-schema", f"vendor.{schema}", tmp_path / "checked.yml")
    checked = subprocess.run(
        [sys.executable, "-m", "check_jsonschema", *words], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout


def test_only_the_deployment_of_the_site_may_write_and_only_official_actions_run():
    assert SITE["permissions"] == {"contents": "read"}
    assert "permissions" not in SITE["jobs"]["build"]
    assert SITE["jobs"]["deploy"]["permissions"] == {"pages": "write", "id-token": "write"}
    steps = [step for job in SITE["jobs"].values() for step in job["steps"]]
    assert all(step.get("uses", "actions/").startswith("actions/") for step in steps)


def test_every_input_is_used_and_every_expression_is_known():
    ids = {f"steps.{step['id']}.outputs.hash" for step in STEPS if "id" in step}
    used = set(EXPRESSION.findall(yaml.dump(STEPS)))
    assert used - ids - set(RUNNER) == {f"inputs.{name}" for name in ACTION["inputs"]}


@pytest.mark.parametrize("name", SHELL_STEPS)
def test_a_script_reads_inputs_from_its_environment_alone(name):
    """An expression in a script would let a branch name or an input run as a command."""
    step = SHELL_STEPS[name]
    assert "${{" not in step["run"]
    own = {"GITHUB_OUTPUT", *re.findall(r"(?m)(\w+)=", step["run"])}
    read = {variable.lower() for variable in re.findall(r"\$\{?([A-Za-z]\w*)", step["run"])}
    given = {variable.lower() for variable in step["env"]} - {"rlbench_cache"}
    assert read - {variable.lower() for variable in own} - {"words"} == given


def test_the_example_and_its_table_name_the_inputs_of_the_action():
    (job,) = yaml.safe_load(WORKFLOW)["jobs"].values()
    assert set(job["steps"][-1]["with"]) <= set(ACTION["inputs"])
    documented = re.findall(r"(?m)^\| `([\w-]+)` \| (\S.*?) \|", HOW_TO.split("| input |")[1])
    defaults = {name: text.strip("`") for name, text in documented}
    for name, declared in ACTION["inputs"].items():
        assert defaults[name] == (declared.get("default") or defaults[name])
    assert list(defaults) == list(ACTION["inputs"])


class Job:
    """A job of a stranger's repository, whose steps run in Bash as on GitHub."""

    def __init__(self, folder: Path, inputs: dict[str, str]) -> None:
        self.folder = folder
        defaults = {name: value.get("default", "") for name, value in ACTION["inputs"].items()}
        self.known = {f"inputs.{name}": value for name, value in {**defaults, **inputs}.items()}
        self.known |= {"runner.temp": str(folder.parent / "temp"), "github.action_path": str(ROOT)}
        self.output, self.summary = folder.parent / "output.txt", folder.parent / "summary.md"

    def run(self, name: str, **environment: str) -> subprocess.CompletedProcess[str]:
        step = SHELL_STEPS[name]
        given = {
            key: EXPRESSION.sub(lambda match: self.known[match[1]], text)
            for key, text in step["env"].items()
        }
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        files = {"GITHUB_OUTPUT": str(self.output), "GITHUB_STEP_SUMMARY": str(self.summary)}
        own = {"OMP_NUM_THREADS": "1", "PATH": path, **files}
        return subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
            cwd=self.folder,
            env={**os.environ, **own, **given, **environment},
            capture_output=True,
            text=True,
        )


@pytest.fixture
def job(tmp_path):
    """A repository with a method, a clip and no baseline yet."""
    folder = tmp_path / "repository"
    folder.mkdir()
    write_plugin(folder / "toy.py", "toy")
    write_noise(folder / "my clips" / "foyer", "foyer")
    inputs = {"methods": "toy,mean", "plugin": "toy.py", "clips": "my clips", "spp": "1"}
    return Job(folder, {**inputs, "baseline": "base line.json", "speed": "mean / toy <= 1e6"})


@pytest.mark.slow
def test_the_steps_pass_and_fail_as_the_method_does(job):
    measured = job.run("Measure")
    assert measured.returncode == 0, measured.stdout + measured.stderr
    missing = job.run("Compare")
    assert missing.returncode == 2
    assert "rlbench regress --update --baseline base line.json makes one" in missing.stderr

    words = ("--results", "rlbench-regress/results", "--baseline", "base line.json", "--update")
    command = (Path(sys.executable).parent / "rlbench", "regress", *words)
    subprocess.run(command, cwd=job.folder, check=True, capture_output=True)
    compared = job.run("Compare")
    assert compared.returncode == 0, compared.stdout + compared.stderr
    assert "passed: 2 same, speed" in compared.stdout

    write_plugin(job.folder / "toy.py", "toy", gain=0.5)
    assert job.run("Measure").returncode == 0
    assert job.run("Compare").returncode == 1
    written = job.folder / "rlbench-regress"
    (suite,) = JUnitXml.fromfile(str(written / "regress.xml"))
    assert (suite.tests, suite.failures) == (3, 1)
    assert (written / "regress-crops" / "difference.png").is_file()
    assert "| WORSE | toy | foyer | 1 |" in (written / "regress.md").read_text()
    assert "| WORSE | toy | foyer | 1 |" in job.summary.read_text()


def test_the_hash_of_a_preset_is_a_key_of_its_cache(job):
    assert job.run("Hash of the preset").returncode == 0
    first = job.output.read_text()
    assert re.fullmatch(r"hash=[0-9a-f]{16}\n", first)
    job.known["inputs.preset"] = "no-such-preset"
    assert job.run("Hash of the preset").returncode != 0
    assert job.output.read_text() == first


@pytest.mark.slow
def test_the_installed_package_has_the_shipped_baseline(job, tmp_path):
    """pip reads options from its environment: no index, no dependencies, a folder of its own."""
    shutil.copytree(
        ROOT, tmp_path / "action", ignore=shutil.ignore_patterns(".*", "results", "runs", "tests")
    )
    job.known["github.action_path"] = str(tmp_path / "action")
    offline = {"PIP_NO_DEPS": "1", "PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0"}
    installed = job.run("Install rlbench", PIP_TARGET=str(tmp_path / "site"), **offline)
    assert installed.returncode == 0, installed.stderr
    baseline = "rlbench/benchmark/regression/baselines/mini.json"
    assert json.loads((tmp_path / "site" / baseline).read_text())["preset"] == "mini"
