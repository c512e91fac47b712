"""Executes notebooks from top to bottom and stores the outputs of their cells.

Outputs and their numbers alone are stored: no times, no paths, no version of the interpreter.
"""

import argparse
import contextlib
import os
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError as CellExecutionError
from nbclient.util import run_sync
from tqdm import tqdm


ROOT = Path(__file__).parents[2]
# Readers need the language of the cells, not the version of the interpreter.
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
# Long enough for a slow machine that is busy with other things.
LONGEST = 600  # s for one cell


@contextlib.contextmanager
def kernel() -> Generator[Any]:
    """A kernel for several notebooks: libraries are imported, and programs compiled, once.

    It starts with the first of them. Yields its manager of `jupyter_client`.
    """
    manager: Any = NotebookClient(
        nbformat.v4.new_notebook(), kernel_name="python3"
    ).create_kernel_manager()
    try:
        yield manager
    finally:
        if manager.has_kernel:
            run_sync(manager.shutdown_kernel)(now=True)


def execute(path: Path, manager: Any = None) -> Any:
    """The notebook with fresh outputs; nothing is written.

    **Arguments**

    - `path`: the notebook.
    - `manager`: of the kernel that runs it, without what earlier notebooks defined. By default a
      kernel of its own.

    **Raises** `nbclient.exceptions.CellExecutionError` at the first cell that fails.
    """
    notebook = nbformat.read(path, as_version=4)
    if manager is not None:
        notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
    # A backend of pictures in the environment is for programs without a notebook.
    environment = {name: text for name, text in os.environ.items() if name != "MPLBACKEND"}
    environment["TQDM_DISABLE"] = "1"  # lines of progress have times
    client = NotebookClient(
        notebook,
        km=manager,
        timeout=LONGEST,
        kernel_name="python3",
        resources={"metadata": {"path": str(ROOT)}},
        record_timing=False,
        coalesce_streams=True,
        # Kernels and clients of one machine communicate unencrypted, and warn of it every time.
        extra_arguments=["--IPKernelApp.log_level=40"],
    )
    client.execute(env=environment, cwd=str(ROOT))
    if manager is not None:
        assert client.kc is not None
        client.kc.stop_channels()
        del notebook.cells[0]
    for cell in notebook.cells:
        cell.metadata.clear()
    notebook.metadata = nbformat.from_dict(METADATA)
    return notebook


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "notebooks", type=Path, nargs="*", help="those of notebooks/ if none is named"
    )
    options = parser.parse_args(argv)
    paths = options.notebooks or sorted((ROOT / "notebooks").glob("*.ipynb"))
    for path in paths:
        if not path.is_file():
            parser.error(f"{path}: no such notebook")
    for path in tqdm(paths, desc="notebooks", unit="notebook", disable=None):
        nbformat.write(execute(path), path)
        print(f"stored the outputs of {path}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
