"""One page made of headings and outputs, which the report's own template shows: a notebook that was never executed."""

from pathlib import Path

import nbformat
from matplotlib.figure import Figure
from nbformat.notebooknode import NotebookNode

from pipeline.report.figures import save
from pipeline.report.notebook import heading_cell, to_html


class Page:
    """Collects what the page shows, from its top to its end; `folder` is where `show` saves figures."""

    def __init__(self, title: str, folder: Path = Path()):
        self._title = title
        self._folder = folder
        self._cells: list[NotebookNode] = []

    def heading(self, level: int, name: str, text: str, words: str = "") -> None:
        """A heading with the words below it (Markdown); `name` is its anchor."""
        self._cells.append(heading_cell(level, name, text, words))

    def html(self, text: str) -> None:
        """A piece of HTML, such as a table."""
        self.output({"text/html": text})

    def show(self, figure: Figure, name: str) -> None:
        """A figure, saved as figures/NAME.svg on the way."""
        self.output(*save(figure, name, self._folder))

    def output(self, data: dict[str, str], metadata: dict[str, dict[str, str]] | None = None) -> None:
        """What a notebook's cell would show, by media type."""
        shown = nbformat.v4.new_output("display_data", data=data, metadata=metadata or {})
        self._cells.append(nbformat.v4.new_code_cell("", id=f"output-{len(self._cells)}", outputs=[shown]))

    def to_html(self) -> str:
        """The page, nothing fetched."""
        notebook = nbformat.v4.new_notebook(cells=self._cells)
        notebook.metadata["title"] = self._title
        return to_html(notebook)
