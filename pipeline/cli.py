"""The command line: thin. Exit 0 done, 1 a check or a case failed, 2 the input or the call is wrong."""

import json
import math
import sys
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from pipeline.errors import InputError, YarnvalError, nearest, refuse_unknown

if TYPE_CHECKING:
    from pipeline.records import CylinderAxis, Quantity, SlopeRatio

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Measure yarn on a moving cylinder, predict it, and publish which model to believe.",
)
progress = Console(stderr=True)
"""Progress goes to stderr, and only to a terminal."""

DEFAULT_STUDIES = Path("data_samples")
Studies = Annotated[
    list[Path] | None,
    typer.Argument(help="Study folders, or folders of studies [default: data_samples].", show_default=False),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")]


def main() -> None:
    """Run `yarnval`. Every user error ends as one line on stderr and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except YarnvalError as error:
        _fail(str(error))
    except typer.TyperException as error:  # a wrong call: unknown option, missing argument, not a number
        context = getattr(error, "ctx", None)
        message = error.format_message() if isinstance(error, typer.BadParameter) else str(error)
        if not message:  # called without a command: the help has been shown
            sys.exit(2)
        hint = f"; see '{context.command_path} --help'" if context else ""
        _fail(f"{message.rstrip('.')}{hint}")
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted")
    except BrokenPipeError:  # the reader of a pipe has left: nobody to tell
        sys.stderr.close()
        sys.exit(2)
    else:
        sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> None:
    print(f"yarnval: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


@app.command(epilog="Example: yarnval report data_samples/yin2020 --out reports")
def report(
    studies: Studies = None,
    out: Annotated[Path, typer.Option(help="Folder that gets one report folder per study.")] = Path("reports"),
) -> int:
    """Ingest, measure, predict, compare and publish a report for each study."""
    from pipeline.case import find_studies
    from pipeline.run import publish_all

    folders = find_studies(studies or [DEFAULT_STUDIES])
    with _status(f"reporting {', '.join(folder.name for folder in folders)}"):
        published = publish_all(folders, out)
    for study in published:
        print(study.report)
    failures = [line for study in published for line in study.failures]
    for line in failures:
        print(line, file=sys.stderr)
    return 1 if failures else 0


@app.command(epilog="Example: yarnval check data_samples --junit check.xml")
def check(
    studies: Studies = None,
    junit: Annotated[Path | None, typer.Option(help="Also write the result as JUnit XML.")] = None,
    as_json: Json = False,
) -> int:
    """Hold each model's errors against the study's bounds: exit 1 if one is exceeded or missing.

    A study's errors are computed anew; those of a report folder are read from its errors.json.
    """
    from pipeline.case import find_studies, load_study
    from pipeline.check import as_json as as_json_row
    from pipeline.check import read_errors, verdict, write_junit
    from pipeline.run import evaluate

    rows = {}
    for path in studies or [DEFAULT_STUDIES]:
        if (path / "errors.json").is_file():
            name, comparisons = read_errors(path)
            rows[name] = [row for row in comparisons if row.bounded]
            continue
        for folder in find_studies([path]):
            with _status(f"checking {folder.name}"):
                results = evaluate(load_study(folder))
            rows[results.name] = [row for row in results.comparisons if row.bounded]
    if junit:
        write_junit(rows, junit)
    broken = [(name, row) for name, bounded in rows.items() for row in bounded if not row.within]
    if as_json:
        document = {name: [as_json_row(row) for row in bounded] for name, bounded in rows.items()}
        _print_json({"passed": not broken, "studies": document})
    else:
        for name, bounded in rows.items():
            for row in bounded:
                print(f"{name}: {verdict(row)}")
        total = sum(map(len, rows.values()))
        print(f"{total - len(broken)} of {total} bounds hold")
    for name, row in broken:
        print(f"{name}: {verdict(row)}", file=sys.stderr)
    return 1 if broken else 0


@app.command(epilog="Example: yarnval predict data_samples/yin2020/case1/case.toml --model flexible,cosserat")
def predict(
    table: Annotated[Path, typer.Argument(help="TABLE.csv or CASE.toml.", metavar="TABLE.csv|CASE.toml")],
    model: Annotated[str, typer.Option(help="One or more models, separated by commas.")] = "cosserat",
    tol: Annotated[float, typer.Option(help="Largest relative error that the model 'auto' may have.")] = 0.01,
    quantity: Annotated[
        str, typer.Option(help="What --tol is for, separated by commas: fewer may need a cheaper model only.")
    ] = "p3_AB_cN,T_AB_tpm,theta_B_deg",
    out: Annotated[Path | None, typer.Option(help="Write the table here instead of stdout.")] = None,
    as_json: Json = False,
) -> int:
    """Solve each scene with each model, one row per case and model; exit 1 if a case failed."""
    import csv

    from pipeline.atomic import whole_file
    from pipeline.case import load_scene
    from pipeline.predict import TableRow, TableScene, predict_rows, read_table

    models, wanted = _models(model), _quantities(quantity)
    if not (math.isfinite(tol) and tol > 0):
        raise InputError("--tol", f"found {tol}", "give a relative error greater than 0, for example 0.01")
    if table.suffix == ".toml":
        scenes = (TableScene(table.parent.name or table.stem, load_scene(table)),)
    else:
        scenes = read_table(table)
    with _Bar(f"solving {len(scenes)} scenes", len(scenes) * len(models)) as advance:
        rows = list(predict_rows(scenes, models, progress=advance, tolerance=tol, wanted=wanted))
    if as_json:
        _print_json([row.as_json() for row in rows])
    else:
        names = [field.name for field in fields(TableRow)]
        lines = [names, *([_cell(getattr(row, name)) for name in names] for row in rows)]
        if out:
            with whole_file(out) as file:
                csv.writer(file, lineterminator="\n").writerows(lines)
        else:
            csv.writer(sys.stdout, lineterminator="\n").writerows(lines)
    failed = [row for row in rows if not row.ok]
    for row in failed:
        print(f"{table}: {row.case} {row.model}: {row.outcome}: {row.message}", file=sys.stderr)
    return 1 if failed else 0


@app.command(epilog="Example: yarnval calibrate data_samples/yin2020 --fit lAB_over_lCD --model cosserat")
def calibrate(
    study: Annotated[Path, typer.Argument(help="A study folder.", metavar="STUDY")],
    fit: Annotated[str, typer.Option(help="Parameters, separated by commas: k, eta, mu, lAB_over_lCD.")] = "k,eta",
    model: Annotated[str, typer.Option(help="The model that is fitted.")] = "cosserat",
    as_json: Json = False,
) -> int:
    """Fit parameters of a model to a study's measurements, with leave-one-case-out errors; changes no file.

    Exit 1 if a fit failed.
    """
    from models.solve import MODELS
    from pipeline.calibrate import PARAMETERS, document, told
    from pipeline.calibrate import calibrate as fitted
    from pipeline.case import find_studies, load_study
    from pipeline.run import measure as measured

    names = [name.strip() for name in fit.split(",") if name.strip()]
    for name in names:
        refuse_unknown("--fit", "parameter", name, list(PARAMETERS))
    if not names or len(set(names)) < len(names):
        raise InputError("--fit", f"found '{fit}'", f"name each parameter once; known: {', '.join(PARAMETERS)}")
    # `auto` takes one model for one scene and another for the next: nothing that could be fitted
    refuse_unknown("--model", "model", model, [name for name in MODELS if name != "auto"])
    folder, *others = find_studies([study])
    if others:
        raise InputError(study, f"{1 + len(others)} studies", "name one of them")
    given = load_study(folder)
    with _status(f"fitting {', '.join(names)} to {given.name}"):
        found = fitted(given, [measured(case) for case in given.cases], model, names)
    if as_json:
        _print_json(document(found))
    else:
        print(told(found))
    for line in found.failures:
        print(f"{study}: {line}", file=sys.stderr)
    return 1 if found.failures else 0


@app.command(epilog="Example: yarnval sweep data_samples/sweeps/yin2020_section3.toml --out reports")
def sweep(
    file: Annotated[Path, typer.Argument(help="SWEEP.toml.", metavar="SWEEP.toml")],
    out: Annotated[Path, typer.Option(help="Folder that gets the sweep's folder.")] = Path("reports"),
    as_json: Json = False,
) -> int:
    """Vary one parameter at a time: tables, figures and a page, beside the numbers that a source quotes.

    Exit 1 if a solve failed; its row stays in the tables with the reason.
    """
    from pipeline.report.sweep import document, failure, write_sweep
    from pipeline.sweep import load_sweep, run_sweep

    given = load_sweep(file)
    folder = out / given.name
    with _status(f"sweeping {given.name}"):
        rows = run_sweep(given)
        write_sweep(given, rows, folder)
    if as_json:
        _print_json(document(given, rows))
    else:
        print(folder / "sweep.html")
    failed = [row for row in rows if not row.ok]
    for row in failed:
        print(f"{file}: {failure(row)}", file=sys.stderr)
    return 1 if failed else 0


@app.command(epilog="Example: yarnval wind data_samples/winding/nine_cases.toml --case '131.2 tex, 1000 r/min'")
def wind(
    scene: Annotated[Path, typer.Argument(help="SCENE.toml: one winding case or many.", metavar="SCENE.toml")],
    mode: Annotated[
        str | None, typer.Option(help="fast, reference or auto, for all cases [default: the file's].")
    ] = None,
    case: Annotated[str | None, typer.Option(help="Wind this case only, with its variants.")] = None,
    out: Annotated[Path, typer.Option(help="Folder that gets the scene's folder.")] = Path("reports"),
    checkpoint: Annotated[
        Path | None, typer.Option(help="Keep the state of reference runs here, and go on from it.", metavar="FILE")
    ] = None,
    log: Annotated[
        list[str] | None, typer.Option(help="Measured tension: CASE=FILE, or FILE if there is one case.")
    ] = None,
    calibrate: Annotated[
        Path | None,
        typer.Option(
            help="Fit the case to a layer profile (CSV: layer, T_over_T0; transverse stiffness, relaxation) or to a "
            "tension log (modulus, friction of the guide).",
            metavar="LOG|PROFILE",
        ),
    ] = None,
    profile: Annotated[str, typer.Option(help="Layout of the logs: a packaged name or a TOML file.")] = "plain-csv",
    as_json: Json = False,
) -> int:
    """Wind yarn onto a bobbin: tension in time, on the package and by layer, beside the paper's findings.

    Exit 1 if a run was not completed; its row stays in the tables with the reason.
    """
    from pipeline.atomic import refuse_strangers
    from pipeline.report.winding import CONTENTS, write_winding
    from pipeline.report.winding_tables import document
    from pipeline.winding.calibration import calibrated
    from pipeline.winding.checkpoint import checkpoints
    from pipeline.winding.run import failed, run_winding
    from pipeline.winding.study import load_winding, with_logs

    if mode is not None:
        refuse_unknown("--mode", "mode", mode, ["fast", "reference", "auto"])
    given = with_logs(load_winding(scene, only=case, mode=mode), log or [], profile)
    folder = out / given.name
    refuse_strangers(folder, CONTENTS.__contains__, "a winding report")  # before minutes of work, not after
    fit = None
    if calibrate:
        with _status(f"calibrating {given.name} on the fast mode"):
            fit = calibrated(given, calibrate, profile)
        given = fit.study
    kept = checkpoints(checkpoint, given.cases) if checkpoint else {}
    with _status(f"winding {given.name}") as shown:
        rows = run_winding(given, progress=_share_told(shown, f"winding {given.name}"), checkpoints=kept)
        write_winding(given, rows, folder, fit)
    if as_json:
        _print_json(document(rows, fit))
    else:
        print(folder / "wind.html")
    for line in failed(rows):
        print(f"{scene}: {line}", file=sys.stderr)
    return 1 if failed(rows) else 0


@app.command(epilog="Example: yarnval bench --out reports --scenes 200")
def bench(
    out: Annotated[Path, typer.Option(help="Folder for the tables, the figures and bench.html.")] = Path("reports"),
    scenes: Annotated[int, typer.Option(min=1, help="Random scenes for the map of outcomes.")] = 200,
    rows: Annotated[int, typer.Option(min=1, help="Rows of the table that is timed.")] = 10_000,
    as_json: Json = False,
) -> int:
    """Work and precision, hard cases and throughput of the models beside scipy's solvers; takes about a minute."""
    from pipeline.bench import endings, fates, throughput, work_precision
    from pipeline.report.bench import write_bench

    try:
        out.mkdir(parents=True, exist_ok=True)  # before minutes of work, not after
    except OSError as error:
        raise InputError(out, f"cannot be made ({error.strerror})", "give a folder that can be written to") from None
    with _status("timing single solves"):
        costs = work_precision()
    with _status(f"solving {scenes} random scenes"):
        found = endings(scenes)
    with _status(f"solving tables of {rows} rows"):
        rates = throughput(rows)
    tables = write_bench(costs, found, rates, out)
    if as_json:
        _print_json(
            {
                "costs": [asdict(c) for c in costs],
                "fates": [asdict(f) for f in fates(found)],
                "rates": [asdict(r) for r in rates],
            }
        )
    else:
        print("\n".join(tables.values()))
    return 0


@app.command(
    epilog="Example: yarnval measure data_samples/rig/case1/yarn.mkv --scale-um-per-px 5 --fps 1200 --axis-deg 90"
)
def measure(
    clip: Annotated[
        Path, typer.Argument(help="A .cine, .mraw, TIFF, AVI, MKV or MP4 clip, an image, or a folder of images.")
    ],
    scale_um_per_px: Annotated[float | None, typer.Option(help="Object scale, µm per pixel.")] = None,
    scale_u_um_per_px: Annotated[
        float | None, typer.Option(help="Standard uncertainty of --scale-um-per-px, in µm per pixel.")
    ] = None,
    scale_from_diameter_mm: Annotated[
        float | None, typer.Option(help="Diameter of the cylinder in view, to take scale and axis from its two edges.")
    ] = None,
    scale_image: Annotated[
        Path | None, typer.Option(help="Image or clip with that cylinder, if it is not in this clip's first frame.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Recording rate where the file does not hold it.")] = None,
    axis_deg: Annotated[float | None, typer.Option(help="Cylinder axis as displayed, ° counter-clockwise.")] = None,
    axis_u_deg: Annotated[float | None, typer.Option(help="Standard uncertainty of --axis-deg, in °.")] = None,
    tilt_u_deg: Annotated[
        float | None, typer.Option(help="Standard uncertainty of the yarn's tilt out of the image plane, in °.")
    ] = None,
    method: Annotated[
        str, typer.Option(help="Twist method: surface (single yarn), ply (with --plies) or tracer (one dyed fibre).")
    ] = "surface",
    slope_ratio: Annotated[
        float | None, typer.Option(help="Twist by the slope of fibres, or tracer, over that by direct counting.")
    ] = None,
    slope_ratio_u: Annotated[float | None, typer.Option(help="Standard uncertainty of --slope-ratio.")] = None,
    plies: Annotated[int | None, typer.Option(help="Strands of a plied yarn, 2 or more, for --method ply.")] = None,
    yarn_speed_m_s: Annotated[
        float | None, typer.Option(help="Speed of the yarn, to the right of the cylinder axis: gives its rotation.")
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(help="Folder that gets annotated frames (24 at most) and a contact sheet as PNG.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Measure angle, twist and diameter in every frame of a clip."""
    from pipeline.ingest.video import open_video
    from pipeline.measure.yarn import METHODS, measure_json, measure_yarn
    from pipeline.records import Scale
    from pipeline.report.overlay import check_folder, write_overlay

    option, given = _scale_option(scale_um_per_px, scale_from_diameter_mm, scale_image)
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise InputError("--fps", f"found {fps}", "give the recording rate in frames per second, greater than 0")
    if method not in METHODS:
        raise InputError("--method", f"unknown method '{method}'", nearest(method, list(METHODS)))
    if (method == "ply") != (plies is not None) or (plies is not None and plies < 2):
        raise InputError(
            "--plies", f"found {plies} with --method {method}", "give 2 or more with --method ply, else none"
        )
    if yarn_speed_m_s is not None and not math.isfinite(yarn_speed_m_s):
        raise InputError("--yarn-speed-m-s", f"found {yarn_speed_m_s}", "give the speed in metres per second")
    if scale_u_um_per_px is not None and scale_um_per_px is None:
        raise InputError("--scale-u-um-per-px", "no --scale-um-per-px to go with it", "give the scale, too")
    if scale_u_um_per_px is not None and not (math.isfinite(scale_u_um_per_px) and scale_u_um_per_px >= 0):
        raise InputError("--scale-u-um-per-px", f"found {scale_u_um_per_px}", "give µm per pixel, 0 or greater")
    axis = _axis_option(axis_deg, axis_u_deg)
    u_tilt = _u_of_angle("--tilt-u-deg", tilt_u_deg)
    ratio = _ratio_option(slope_ratio, slope_ratio_u, method)
    if overlay:
        check_folder(overlay)
    with _status(f"measuring {clip}"):
        video = open_video(clip, fps=fps, hashed=False)
        origin: dict[str, object] = {"from": option}
        if scale_from_diameter_mm is None:
            scale = Scale(given * 1e-6, math.nan if scale_u_um_per_px is None else scale_u_um_per_px / given)
            origin |= {} if scale_u_um_per_px is None else {"u_percent": 100 * scale.relative_u}
        else:
            from pipeline.measure.scale import REMARK, cylinder_in  # scipy's statistics: half of the start's time

            seen = open_video(scale_image, fps=fps or 1.0, hashed=False) if scale_image else video
            cylinder = cylinder_in(seen.frames, scale_image or clip)
            scale = cylinder.scale(given * 1e-3)
            origin |= {"diameter_px": cylinder.diameter, "u_percent": 100 * scale.relative_u, "remark": REMARK}
            if axis is None and scale_image is None:
                axis = cylinder.axis
                origin |= {"axis_deg": math.degrees(axis.angle), "u_axis_deg": math.degrees(axis.u)}
        measured = measure_yarn(
            video, scale, cylinder_axis=axis, u_tilt=u_tilt, ratio=ratio, method=method, plies=plies,
            speed=yarn_speed_m_s,
        )  # fmt: skip
        if overlay:
            write_overlay(measured, scale, overlay)
    document = measure_json(measured) | {"scale": {"um_per_px": scale.metres_per_pixel * 1e6, **origin}}
    if as_json:
        _print_json(document)
    else:
        _print_summary(document)
    return 0


@app.command(epilog="Example: yarnval tension data_samples/rig/case1/tension_plain.csv --profile plain-csv")
def tension(
    log: Annotated[Path, typer.Argument(help="A tension log.")],
    profile: Annotated[str, typer.Option(help="Layout: a packaged name or a TOML file.")] = "plain-csv",
    channel: Annotated[str | None, typer.Option(help="Column to read instead of the layout's.")] = None,
    window: Annotated[str | None, typer.Option(help="Seconds A:B; either side may be left out.", metavar="A:B")] = None,
    as_json: Json = False,
) -> int:
    """Tension statistics and flags of a log."""
    from pipeline.ingest.layouts import load_layout
    from pipeline.ingest.tension import read_tension
    from pipeline.measure.tension import measure_tension, tension_json

    span = _window(window)
    raw = read_tension(log, load_layout(profile, Path()), channel=channel)
    document = tension_json(measure_tension(raw, span))
    if as_json:
        _print_json(document)
    else:
        _print_summary(document)
    return 0


def _scale_option(um_per_px: float | None, diameter_mm: float | None, image: Path | None) -> tuple[str, float]:
    """Return the option that gives the scale and its value, which is positive."""
    if um_per_px is not None and diameter_mm is not None:
        raise InputError("--scale-from-diameter-mm", "the scale is given twice", "leave --scale-um-per-px out")
    if diameter_mm is None:
        option, given = "--scale-um-per-px", um_per_px
        right = "give µm per pixel, or --scale-from-diameter-mm: no scale, no mm and no tpm"
    else:
        option, given = "--scale-from-diameter-mm", diameter_mm
        right = "give the cylinder's diameter in mm, greater than 0"
    if given is None or not (math.isfinite(given) and given > 0):
        raise InputError(option, f"found {given}", right)
    if image and diameter_mm is None:
        raise InputError("--scale-image", "no diameter to go with it", "give --scale-from-diameter-mm")
    return option, given


def _axis_option(axis_deg: float | None, u_deg: float | None) -> "CylinderAxis | None":
    """Return the cylinder's axis as given."""
    from pipeline.records import CylinderAxis

    if axis_deg is None:
        if u_deg is not None:
            raise InputError("--axis-u-deg", "no --axis-deg to go with it", "give the axis, too")
        return None
    if not math.isfinite(axis_deg):
        raise InputError("--axis-deg", f"found {axis_deg}", "give the cylinder axis in degrees as displayed")
    return CylinderAxis(math.radians(axis_deg), _u_of_angle("--axis-u-deg", u_deg))


def _u_of_angle(option: str, u_deg: float | None) -> float:
    """Return an angle's standard uncertainty [rad], NaN where it is not given."""
    if u_deg is None:
        return math.nan
    if not 0 <= u_deg < 45:
        raise InputError(option, f"found {u_deg}", "give degrees, 0 or greater and below 45")
    return math.radians(u_deg)


def _ratio_option(value: float | None, u: float | None, method: str) -> "SlopeRatio | None":
    """Return the ratio of the slope to direct counting as given."""
    from pipeline.records import SlopeRatio

    if value is None and u is None:
        return None
    if value is None or u is None or not (0 < value < math.inf and 0 <= u < math.inf):
        raise InputError("--slope-ratio", f"found {value} with --slope-ratio-u {u}", "give both, greater than 0")
    if method == "ply":
        raise InputError("--slope-ratio", "given with --method ply", "it is for fibres' slope: leave it out")
    return SlopeRatio(value, u)


def _models(names: str) -> list[str]:
    from models.solve import MODELS

    chosen = [name.strip() for name in names.split(",") if name.strip()]
    for name in chosen:
        if name not in MODELS:
            raise InputError("--model", f"unknown model '{name}'", nearest(name, list(MODELS)))
        if chosen.count(name) > 1:
            raise InputError("--model", f"'{name}' stands twice", "name each model once")
    if not chosen:
        raise InputError("--model", "no model named", f"known: {', '.join(MODELS)}")
    return chosen


def _quantities(names: str) -> "list[Quantity]":
    from pipeline.records import Quantity

    known = [quantity.value for quantity in Quantity]
    chosen = [name.strip() for name in names.split(",") if name.strip()]
    for name in chosen:
        if name not in known:
            raise InputError("--quantity", f"unknown quantity '{name}'", nearest(name, known))
    if not chosen:
        raise InputError("--quantity", "no quantity named", f"known: {', '.join(known)}")
    return [Quantity(name) for name in chosen]


def _window(text: str | None) -> tuple[float | None, float | None] | None:
    if text is None:
        return None
    parts = text.split(":")
    try:
        start, end = (float(part) if part.strip() else None for part in parts)
    except ValueError:
        raise InputError("--window", f"found '{text}'", "give seconds as A:B, for example 2.5:20") from None
    return start, end


def _status(text: str) -> Any:
    return progress.status(text) if progress.is_terminal else _Quiet()


class _Bar:
    """A progress bar on a terminal, else nothing."""

    def __init__(self, text: str, total: int):
        from rich.progress import Progress

        self._progress = Progress(console=progress, disable=not progress.is_terminal, transient=True)
        self._task = self._progress.add_task(text, total=total)

    def __enter__(self) -> Callable[[int], None]:
        self._progress.start()
        return lambda done: self._progress.advance(self._task, done)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _share_told(shown: Any, text: str) -> Callable[[float, float], None] | None:
    """Show the share of the work done and the time left; None where nothing is shown."""
    if shown is None:
        return None
    return lambda share, left: shown.update(f"{text}: {share:.0%}, about {left:.0f} s left")


class _Quiet:
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


def _cell(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def _print_json(document: object) -> None:
    print(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def _print_summary(document: dict[str, Any]) -> None:
    """Scalars and small tables of a JSON document as lines; the series are only in --json."""
    for key, value in document.items():
        if isinstance(value, dict):
            for name, part in value.items():
                told = part.items() if isinstance(part, dict) else ()
                shown = ", ".join(f"{k} {_short(v)}" for k, v in told if v != "" and not isinstance(v, dict))
                shown = shown if isinstance(part, dict) else _short(part)
                print(f"{key}.{name}: {shown}")
        elif not isinstance(value, list):
            print(f"{key}: {_short(value)}")


def _short(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
