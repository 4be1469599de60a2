"""examples/whole_way.ipynb runs from top to bottom without a warning, and is kept with its output."""

import itertools
import subprocess
import sys
import tempfile
from pathlib import Path

import nbformat
import pytest

PAGE = Path(__file__).parents[2] / "examples" / "whole_way.ipynb"
STRICT = "import warnings\nwarnings.simplefilter('error')"
# a process of its own: the client leaves its sockets to the garbage. A socket file: nobody else on this
# machine can talk to the kernel
RUN = """
import sys, nbformat
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
page, folder = sys.argv[1:]
notebook = nbformat.read(page, 4)
kernel = AsyncKernelManager(kernel_name="python3", transport="ipc", ip=folder + "/kernel")
NotebookClient(notebook, km=kernel, timeout=300, resources={"metadata": {"path": folder}}).execute()
nbformat.write(notebook, page)
"""


def texts(cell):
    return "".join(o.get("text", "") for o in cell.outputs)


def kinds(cell):
    """What a cell shows, in order; text that a busy machine sends in two parts is one text."""
    shown = [tuple(sorted(o.get("data", {}))) for o in cell.outputs]
    return [kind for kind, _ in itertools.groupby(shown, key=lambda kind: kind or "text")]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_notebook_of_the_whole_way_runs_and_shows_what_it_says(tmp_path):
    notebook = nbformat.read(PAGE, 4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs for cell in code[1:])  # whoever reads it on a web page sees the pictures
    ran = nbformat.v4.new_notebook(metadata=notebook.metadata)
    ran.cells = [nbformat.v4.new_code_cell(STRICT), *(nbformat.v4.new_code_cell(c.source) for c in code)]
    nbformat.write(ran, tmp_path / "ran.ipynb")
    with tempfile.TemporaryDirectory() as folder:  # a socket's path is at most 107 characters long
        command = [sys.executable, "-c", RUN, str(tmp_path / "ran.ipynb"), folder]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert not list(Path(folder).glob("*.*"))  # it writes nothing
    ran = nbformat.read(tmp_path / "ran.ipynb", 4)
    for new, old in zip(ran.cells[1:], code, strict=True):
        assert not [o for o in new.outputs if o.get("name") == "stderr"], new.source
        assert kinds(new) == kinds(old), new.source
    reported = "\n".join(texts(cell) for cell in ran.cells)
    assert "battery_voltage" in reported and "fitted          most thrust 408 N" in reported
