"""The report as a notebook of thin calls, executed, and as one HTML page that opens offline."""

import os
import re
import sys
from collections.abc import Callable
from html import escape
from pathlib import Path

import nbformat
import xarray as xr
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbconvert import HTMLExporter
from nbformat.notebooknode import NotebookNode
from traitlets import default

from pipeline.records import Quantity
from pipeline.report import figures, tables

_PAGES = Path(__file__).parent
_FIGURE_13 = {
    Quantity.TENSION_AB: ("fig13a_tension", "Tension before the cylinder"),
    Quantity.TWIST_AB: ("fig13b_twist", "Twist before the cylinder"),
    Quantity.THETA_B: ("fig13c_theta", "Angle where the contact starts"),
}
_METHOD = """\
The yarn runs from the rollers A over the cylinder, which it touches from B to C, to the guide D; the surface of the
cylinder moves along its axis. Each model takes what is known behind the cylinder (tension p₃ and twist T between C and
D, speeds, contact angle φ, friction μ, rigidity K) and predicts what is found before it: the tension p₃AB, the twist
T_AB and the angle θ_B between yarn and cylinder axis.

- **capstan**: friction along the yarn only, p₃ = p₃CD · exp(−μ(φ − ψ)); the twist stays as it is.
- **flexible**: friction along and across the yarn, no bending.
- **cosserat**: the rod model as the paper prints it.
- **cosserat-fd**: the same equations, solved by the paper's own finite differences.
- **kirchhoff**: the consistent rod, in which bending and torsion act as elasticity theory says.

The comparison error is E = S − M, simulation minus measurement. Its validation uncertainty is
u_val = √(u_num² + u_input² + u_D²) (ASME V&V 20): from the numerics, from the inputs, and from the measured value.
Where |E| < u_val the comparison cannot tell the error from the uncertainty. A term that is not stated counts as 0, and
u_val is then marked ≥."""


def build(tree: xr.DataTree) -> NotebookNode:
    """Compose the notebook of a study, not yet executed. It reads results.nc beside it and holds no logic."""
    cells: list[NotebookNode] = []

    def heading(level: int, name: str, text: str, words: str) -> None:
        cells.append(heading_cell(level, name, text, words))

    def call(code: str) -> None:
        cells.append(nbformat.v4.new_code_cell(code, id=f"call-{len(cells)}"))

    heading(1, "title", tree.attrs["title"], _banner(tree))
    call(
        "from IPython.display import HTML\n\n"
        "from pipeline import store\nfrom pipeline.report import figures, tables\n\n"
        'tree = store.read_tree("results.nc")'
    )
    heading(2, "summary", "Summary", "")
    call("HTML(tables.summary_html(tree))")
    heading(
        2, "table-2", "Table 2: models against measurement",
        "Each row holds one model against one measured quantity of one case. M is the measured mean, S the simulated "
        "value. A dash marks what is not known; point at it for the reason.",
    )  # fmt: skip
    call("HTML(tables.table2_html(tree))")
    heading(
        2, "figure-13", "Figure 13: measured and simulated values",
        "The nearer a model's mark lies to the black diamond, the better it predicts that case; inside the error "
        "bar the measurement cannot tell the two apart.",
    )  # fmt: skip
    for quantity, (name, text) in _FIGURE_13.items():
        heading(3, name.replace("_", "-"), text, "")
        call(f'figures.show(figures.measured_against_models(tree, "{quantity}"), "{name}")')
    heading(
        2, "speed", "Accuracy against speed",
        "A model that is both quick and near the measurement is the one to use. u_num is the numerical error of the "
        "solution: where it is small beside the error, the error is the model's.",
    )  # fmt: skip
    call("HTML(tables.speed_html(tree))")
    call('figures.show(figures.error_against_speed(tree), "error_against_speed")')
    if set(figures.FRAME_TERM_MODELS) <= set(tables.models(tree)):
        heading(
            2, "frame-term", "What bending adds, and what the printed equations add",
            "The consistent rod has the same stiffness as the printed one. What is left between the two is one term, "
            "(B − K)κτ² in the balance of forces, which acts as extra tension.",
        )  # fmt: skip
        call('figures.show(figures.frame_term(tree), "frame_term")')
    heading(
        2, "contact", "Along the contact",
        "What each model says happens to the yarn while it lies on the cylinder, and the path that it takes over it.",
    )  # fmt: skip
    names = _file_names(tables.cases(tree))
    for case, name in names.items():
        if any("theta" in node for node in tree[f"profiles/{case}"].children.values()):
            heading(3, f"contact-{name}", case, "")
            call(f'figures.show(figures.profiles(tree, {case!r}), "profiles_{name}")')
            call(f'figures.show(figures.path(tree, {case!r}), "path_{name}")')
    heading(
        2, "measured", "What was measured",
        "u is the standard uncertainty used in the comparison. Neighbouring samples resemble each other, so that n "
        "samples tell only as much as the smaller, effective number of independent ones.",
    )  # fmt: skip
    call("HTML(tables.measured_html(tree))")
    for case, name in names.items():
        _raw(tree, case, name, heading, call)
    heading(2, "solves", "Solves", "Every solve with its outcome; a failed one keeps its row and gives the reason.")
    call("HTML(tables.solves_html(tree))")
    heading(2, "method", "Method", _METHOD)
    heading(2, "provenance", "Provenance", "Which files went in, and which versions and settings made this report.")
    call("HTML(tables.provenance_html(tree))")
    notebook = nbformat.v4.new_notebook(cells=cells)
    notebook.metadata["title"] = tree.attrs["title"]
    return notebook


def heading_cell(level: int, name: str, text: str, words: str) -> NotebookNode:
    """A heading of the page with the words below it (Markdown); `name` is its anchor."""
    cell = nbformat.v4.new_markdown_cell(f"{'#' * level} {_plain(text)}\n\n{words}".strip(), id=name)
    cell.metadata["heading"] = {"level": level, "text": text}
    return cell


def _raw(
    tree: xr.DataTree,
    case: str,
    name: str,
    heading: Callable[[int, str, str, str], None],
    call: Callable[[str], None],
) -> None:
    recordings = tree["measured"].children.get(case) if "measured" in tree.children else None
    parts = list(recordings.children) if recordings is not None else []
    if not parts:
        return
    heading(
        3, f"measured-{name}", f"Recordings of {case}",
        "The logs and clips as recorded. Nothing is altered: what is doubtful is marked and left out of the means.",
    )  # fmt: skip
    for part in parts:
        kind, index = part.split("_")
        if kind == "tension":
            call(f'figures.show(figures.tension_trace(tree, {case!r}, {index}), "tension_{name}_{index}")')
            continue
        call(f'figures.show(figures.clip_series(tree, {case!r}, {index}), "clip_{name}_{index}")')
        if "thumbnail" in tree[f"measured/{case}/{part}"]:
            call(f'figures.show(figures.contact_sheet(tree, {case!r}, {index}), "frames_{name}_{index}")')


def _banner(tree: xr.DataTree) -> str:
    if not tree.attrs["synthetic"]:
        return ""
    return (
        '<p class="synthetic" role="note"><strong>SYNTHETIC.</strong> The "measured" data of this study were computed '
        "by a program. They test the method and say nothing about a real yarn.</p>"
    )


def _plain(text: str) -> str:
    """Text that Markdown shows as it stands."""
    return re.sub(r"([\\`*_\[\]#|$])", r"\\\1", escape(text, quote=False))


def _file_names(cases: list[str]) -> dict[str, str]:
    """By case, a name fit for files and ids, each used once."""
    names: dict[str, str] = {}
    for case in cases:
        name = re.sub(r"[^A-Za-z0-9-]+", "-", case)[:40]
        names[case] = name if name not in names.values() else f"{name}-{len(names)}"
    return names


class _ThisInterpreter(AsyncKernelManager):
    """Kernel of the running interpreter, whatever kernels the user has installed under that name."""

    @default("kernel_spec_manager")
    def _no_installed_kernels(self) -> KernelSpecManager:
        return KernelSpecManager(parent=self, kernel_dirs=[])

    @default("transport_encryption")
    def _encrypted_where_possible(self) -> str:
        return "auto"


def execute(notebook: NotebookNode, folder: Path) -> None:
    """Run the notebook in place, in `folder`, with this interpreter; leave no time stamps and no paths in it.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell fails, which is a defect of this program.
    """
    client = NotebookClient(
        notebook,
        kernel_manager_class=_ThisInterpreter,
        kernel_name="python3",
        timeout=None,
        record_timing=False,
        shutdown_kernel="immediate",
        resources={"metadata": {"path": str(folder)}},
    )
    # The user's own IPython start-up files stay out of it.
    client.execute(env=os.environ | {"IPYTHONDIR": str(folder / ".ipython")})
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata["language_info"] = {"name": "python", "version": f"{sys.version_info.major}"}


def to_html(notebook: NotebookNode) -> str:
    """The executed notebook as one page: inputs hidden, figures inline, nothing fetched."""
    exporter = HTMLExporter(template_name="page", extra_template_basedirs=[str(_PAGES)], exclude_anchor_links=True)
    html, _ = exporter.from_notebook_node(notebook)
    # The exporter parses its page once more; the drawings are put in afterwards and stay as they were made.
    drawings = {
        output.metadata["image/svg+xml"]["name"]: output.data["image/svg+xml"]
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if "image/svg+xml" in output.get("data", {})
    }
    return re.sub(r'<svg data-figure="([^"]+)"></svg>', lambda found: drawings[found[1]], html)
