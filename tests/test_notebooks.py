"""The notebooks: they run, and what is committed is what a fresh run shows."""

import json
import re
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST = 400_000
"""Bytes of a notebook with its pictures."""
FOREIGN = re.compile(r"/(work|home|root|tmp|Users)\b|[A-Z]:\\\\|site-packages|at 0x")
"""Traces of the machine on which a notebook ran."""

each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path):
    return json.loads(path.read_text())


def code(path):
    """Cells of code."""
    return [cell for cell in read(path)["cells"] if cell["cell_type"] == "code"]


def text_of(output):
    """What an output says, without the bytes of pictures."""
    data = {name: x for name, x in output.get("data", {}).items() if not name.startswith("image/")}
    return json.dumps([data, output.get("text", "")])


def test_there_are_six():
    assert [path.stem[:2] for path in NOTEBOOKS] == [f"{k:02d}" for k in range(1, 7)]


@each
def test_it_was_run_from_the_first_cell_to_the_last(path):
    counts = [cell["execution_count"] for cell in code(path)]
    assert counts == list(range(1, len(counts) + 1))
    assert read(path)["metadata"]["kernelspec"]["name"] == "python3"


@each
def test_its_outputs_are_there_without_errors_and_warnings(path):
    outputs = [output for cell in code(path) for output in cell["outputs"]]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2
    assert not [x for x in outputs if x["output_type"] == "error" or x.get("name") == "stderr"]
    assert not any("Warning" in text_of(output) for output in outputs)


@each
def test_it_tells_nothing_of_a_machine(path):
    cells = read(path)["cells"]
    said = ["".join(cell["source"]) for cell in cells]
    said += [text_of(output) for cell in code(path) for output in cell["outputs"]]
    assert not [match[0] for text in said if (match := FOREIGN.search(text))]
    assert not any("metadata" in cell and cell["metadata"] for cell in cells)


@each
def test_it_can_be_read_in_a_few_minutes(path):
    assert path.stat().st_size < LARGEST
    assert max(len("".join(cell["source"]).split("\n")) for cell in code(path)) <= 22
    words = " ".join("".join(c["source"]) for c in read(path)["cells"] if c["cell_type"] != "code")
    assert len(words.split()) < 1000


@each
def test_the_readme_leads_to_it(path):
    assert f"(notebooks/{path.name})" in (ROOT / "README.md").read_text()


@pytest.mark.long
@each
def test_it_runs_in_a_fresh_kernel(path, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    book = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=600, resources=resources).execute()
    for cell in book.cells:
        for output in cell.get("outputs", []):
            assert output.get("name") != "stderr", output["text"]
