"""One page made of headings and outputs, which the report's own template shows: a notebook that was never executed."""

import nbformat
from nbformat.notebooknode import NotebookNode

from pipeline.report.notebook import heading_cell, to_html


class Page:
    """Collects what the page shows, from its top to its end."""

    def __init__(self, title: str):
        self._title = title
        self._cells: list[NotebookNode] = []

    def heading(self, level: int, name: str, text: str, words: str = "") -> None:
        """A heading with the words below it (Markdown); `name` is its anchor."""
        self._cells.append(heading_cell(level, name, text, words))

    def html(self, text: str) -> None:
        """A piece of HTML, such as a table."""
        self.output({"text/html": text})

    def output(self, data: dict[str, str], metadata: dict[str, dict[str, str]] | None = None) -> None:
        """What a notebook's cell would show, by media type; `figures.save` gives both arguments."""
        shown = nbformat.v4.new_output("display_data", data=data, metadata=metadata or {})
        self._cells.append(nbformat.v4.new_code_cell("", id=f"output-{len(self._cells)}", outputs=[shown]))

    def to_html(self) -> str:
        """The page, nothing fetched."""
        notebook = nbformat.v4.new_notebook(cells=self._cells)
        notebook.metadata["title"] = self._title
        return to_html(notebook)
