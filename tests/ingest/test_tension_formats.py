"""Logs that are no plain text: LabVIEW's .lvm and TDMS, Excel workbooks; the real samples, and every refusal."""

import datetime
import random
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter

from pipeline.errors import InputError
from pipeline.ingest.layouts import load_layout
from pipeline.ingest.tension import read_tension
from pipeline.records import TensionFlag

SAMPLES = Path(__file__).parents[3] / "shared" / "samples"


def sample(name):
    path = SAMPLES / name
    if not path.exists():
        pytest.skip(f"samples folder missing: {name}")
    return path


def layout(base, folder, **keys):
    lines = [f'base = "{base}"', *(f"{key} = {value!r}" for key, value in keys.items())]
    (folder / "mine.toml").write_text("\n".join(lines), encoding="utf-8")
    return load_layout("mine.toml", folder)


def refusal(path, chosen, **kw):
    with pytest.raises(InputError) as refused:
        read_tension(path, chosen, **kw)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


# LabVIEW, text.

HEADER = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tNo\nOperator\tKim\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\t\nY_Unit_Label\tV\tcN\t\nX0\t0,0\t0,5\t\nDelta_X\t1,0\t1,0E-2\t\n"
    "***End_of_Header***\t\t\t\nX_Value\tGauge\tTension\tComment\n"
)
ROWS = "\t0,1\t12,3\n\t0,2\t\n\t0,3\t12,4\tknot\n\t0,4\t12,6\n"


def lvm(folder, text):
    path = folder / "log.lvm"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["short.lvm", "short_new_line_end.lvm"])
def test_lvm_sample_without_x_column(name, tmp_path):
    mine = layout("labview-lvm", tmp_path, tension_column="Excitation (Trigger)")
    raw = read_tension(sample(f"lvm/{name}"), mine)
    assert raw.unit_in_file == "Newtons"
    assert raw.tension.tolist()[:2] == [0.914018, 0.537321]
    assert raw.tension.size == 10
    np.testing.assert_allclose(raw.time, np.arange(10) * 3.90625e-5, rtol=1e-12)
    assert raw.metadata["Operator"] == "JS"


def test_lvm_sample_with_comments_and_another_unit(tmp_path):
    mine = layout("labview-lvm", tmp_path, encoding="cp1252", tension_column="Volume (ml)", unit="cN")
    assert "unit 'ml'" not in refusal(sample("lvm/with_comments.lvm"), mine)
    assert "'ml' is not a known unit of tension" in refusal(sample("lvm/with_comments.lvm"), mine)


def test_lvm_sample_with_empty_fields(tmp_path):
    mine = layout("labview-lvm", tmp_path, tension_column="Dev0/Ai2", unit="N")
    raw = read_tension(sample("lvm/with_empty_fields.lvm"), mine)
    assert raw.tension.tolist()[:3] == [7.254639, 7.254639, 7.250977]
    np.testing.assert_allclose(raw.time, np.arange(7) * 1e-3, atol=1e-12)
    empty = refusal(sample("lvm/with_empty_fields.lvm"), mine, channel="Untitled 2")
    assert "column 'Untitled 2': no reading in any row" in empty
    unitless = load_layout("labview-lvm", Path())
    assert "the file states no unit; set the layout's unit" in refusal(
        sample("lvm/with_empty_fields.lvm"), unitless, channel="Dev0/Ai0"
    )


def test_lvm_spacing_unit_comments_and_missing_readings(tmp_path):
    raw = read_tension(lvm(tmp_path, HEADER + ROWS), load_layout("labview-lvm", Path()))
    np.testing.assert_allclose(raw.tension, [0.123, np.nan, 0.124, 0.126], rtol=1e-14)
    np.testing.assert_allclose(raw.time, [0, 0.01, 0.02, 0.03], atol=1e-15)
    assert raw.flag.tolist() == [0, TensionFlag.MISSING, 0, 0]
    assert raw.unit_in_file == "cN"
    assert raw.metadata["Operator"] == "Kim"
    cut = read_tension(lvm(tmp_path, HEADER + ROWS[:-3]), load_layout("labview-lvm", Path()))
    assert cut.flag.tolist()[2:] == [0, TensionFlag.MISSING]  # "12" of 12,6: cut short


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ("LabVIEW Measurement", "Labview", "line 1: no 'LabVIEW Measurement'; give a measurement file in text"),
        ("X_Columns\tNo", "X_Columns\tMulti", "each channel has X values of its own; save it with one X column"),
        ("Delta_X\t1,0\t1,0E-2", "Delta_X\t1,0\t0,0", "line 12: Delta_X is '0,0'; a file without X column says"),
        ("X0\t0,0\t0,5", "X0\t0,0\tzero", "line 11: X0 is 'zero'"),
        ("Delta_X", "Delta_Y", "log.lvm: Delta_X is ''"),
        ("X_Value\tGauge", "Time\tGauge", "line 14: 'Time'; the column names begin with X_Value"),
        ("Tension\tComment", "Tensile\tComment", "line 14: no column 'Tension'; did you mean 'Tensile'?"),
        ("Tension\tComment", "Gauge\tComment", "no column 'Tension'"),
        ("12,4", "12.4", "line 17 column 'Tension': '12.4' is not a number; the layout says decimal = ','"),
        ("Separator\t,", "Separator\t;", "Decimal_Separator is ';'; it should be '.' or ','"),
        (ROWS, "", "no data after line 14"),
        (ROWS, ROWS + "\t\n***End_of_Header***\n", "line 20: 2 blocks of data; save each recording as a file"),
        ("***End_of_Header***\t\t\t\n", "", "1 lines ***End_of_Header*** and no data after them"),
        ("\tcN\t", "\tlbf\t", "'lbf' is not a known unit of tension"),
    ],
)
def test_bad_lvm_is_refused(tmp_path, was, now, says):
    assert was in HEADER + ROWS
    path = lvm(tmp_path, (HEADER + ROWS).replace(was, now))
    assert says in refusal(path, load_layout("labview-lvm", Path()))


# LabVIEW, TDMS.


def tdms(folder, *channels, name="log.tdms"):
    path = folder / name
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [ChannelObject(group, title, data, properties) for group, title, data, properties in channels]
        )
    return path


TENSION = ("Meter", "Tension", np.array([12.3, np.nan, 12.5]), {"wf_increment": 0.01, "unit_string": "cN"})


def test_tdms_samples(tmp_path):
    mine = layout("labview-tdms", tmp_path, tension_column="Untitled", unit="N")
    raw = read_tension(sample("tdms/raw_timestamps.tdms"), mine)
    np.testing.assert_allclose(raw.time, np.arange(128) * 1e-3, atol=1e-12)
    np.testing.assert_allclose(raw.tension[:3], [0, 0.04906767, 0.09801714], atol=1e-8)
    assert raw.metadata["wf_start_time"].startswith("2024-01-24T01:48:43.068614")
    line = "Dev1_port3_line7 - line 0"
    several = refusal(sample("tdms/Digital_Input.tdms"), mine, channel=line)
    assert f"a channel '{line}' in each of the groups" in several
    assert "set table to one of them" in several
    group = "07/09/2012 06:58:23 PM - Digital Input - Decimated Data_Level1"
    mine = layout("labview-tdms", tmp_path, tension_column=line, unit="N", table=group)
    raw = read_tension(sample("tdms/Digital_Input.tdms"), mine)
    assert raw.tension.size == 400
    assert raw.time[1] == 0.025


def test_tdms_spacing_unit_and_missing_readings(tmp_path):
    raw = read_tension(tdms(tmp_path, TENSION), load_layout("labview-tdms", Path()))
    assert raw.unit_in_file == "cN"
    np.testing.assert_allclose(raw.tension, [0.123, np.nan, 0.125], rtol=1e-14)
    np.testing.assert_allclose(raw.time, [0, 0.01, 0.02], atol=1e-15)
    assert raw.flag[1] == TensionFlag.MISSING


def test_a_tdms_file_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = tdms(tmp_path, ("Meter", "Tension", np.arange(100.0), TENSION[3]))
    path.write_bytes(path.read_bytes()[:-400])
    raw = read_tension(path, load_layout("labview-tdms", Path()))
    np.testing.assert_allclose(raw.tension, np.arange(50) / 100, rtol=1e-14)
    assert "the file was cut off" in raw.metadata["incomplete"]


def test_tdms_time_from_a_channel(tmp_path):
    start = np.datetime64("2024-03-01T12:00:00.000", "us")
    stamps = start + np.array([0, 10_000, 30_000]).astype("timedelta64[us]")
    path = tdms(tmp_path, TENSION, ("Meter", "Stamp", stamps, {}), ("Meter", "Seconds", np.array([5.0, 5.5, 7.0]), {}))
    raw = read_tension(path, layout("labview-tdms", tmp_path, time_column="Seconds"))
    assert raw.time.tolist() == [0, 0.5, 2.0]
    raw = read_tension(path, layout("labview-tdms", tmp_path, time_column="Stamp", time_kind="datetime"))
    np.testing.assert_allclose(raw.time, [0, 0.01, 0.03], atol=1e-9)
    raw = read_tension(path, layout("labview-tdms", tmp_path, time_column="", rate_Hz=50))
    np.testing.assert_allclose(raw.time, [0, 0.02, 0.04], atol=1e-15)


@pytest.mark.parametrize(
    ("channels", "keys", "says"),
    [
        ([TENSION], {"tension_column": "Tensoin"}, "no channel 'Tensoin'; did you mean 'Tension'?"),
        ([TENSION], {"table": "Meters"}, "no group 'Meters'; did you mean 'Meter'?"),
        ([TENSION], {"unit": "N"}, "unit 'cN'; the layout reads it as 'N'"),
        (
            [("Meter", "Tension", np.ones(3), {"unit_string": "N"})],
            {},
            "channel 'Tension': no channel 'time_s', and wf_increment is None; set time_column",
        ),
        (
            [TENSION, ("Meter", "t", np.arange(4.0), {})],
            {"time_column": "t"},
            "channel 't': 4 samples, 'Tension' has 3; set time_column to the time of 'Tension'",
        ),
        (
            [("Meter", "Tension", ["1.2", "slack"], {"wf_increment": 0.1, "unit_string": "N"})],
            {},
            "column 'Tension': 'slack' is not a number",
        ),
        ([("Meter", "Tension", np.ones(2), {"wf_increment": 0.1})], {}, "the file states no unit"),
    ],
)
def test_bad_tdms_is_refused(tmp_path, channels, keys, says):
    assert says in refusal(tdms(tmp_path, *channels), layout("labview-tdms", tmp_path, **keys))


# Workbooks.


def xlsx(folder, *sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    path = folder / "log.xlsx"
    book.save(path)
    return path


PLAIN = [["Operator", "Kim"], [], ["time_s", "tension_cN", "remark"], [0, 12, None], [0.01, 12.5, "knot"], [0.02]]


def test_workbook_with_a_preamble_and_a_row_that_lacks_a_reading(tmp_path):
    raw = read_tension(xlsx(tmp_path, ("Log", PLAIN)), load_layout("excel", Path()))
    np.testing.assert_allclose(raw.tension, [0.12, 0.125, np.nan], rtol=1e-14)
    assert raw.time.tolist() == [0, 0.01, 0.02]
    assert raw.flag.tolist() == [0, 0, TensionFlag.MISSING]
    assert raw.metadata["Operator"] == "Kim"


def test_workbook_with_dates_in_a_named_sheet(tmp_path):
    start = datetime.datetime(2024, 3, 1, 12, 0, 0)
    rows = [["Zeit", "Kraft [N]"], *([start + datetime.timedelta(seconds=i / 4), 0.1 + i / 100] for i in range(4))]
    path = xlsx(tmp_path, ("Notes", [["x"]]), ("Log", rows))
    keys = {"time_column": "Zeit", "time_kind": "datetime", "tension_column": "Kraft [N]", "unit": "N"}
    raw = read_tension(path, layout("excel", tmp_path, table="Log", **keys))
    np.testing.assert_allclose(raw.time, [0, 0.25, 0.5, 0.75], atol=1e-3)  # Excel keeps a date to about 1 ms
    np.testing.assert_allclose(raw.tension, [0.1, 0.11, 0.12, 0.13], rtol=1e-14)
    assert "2 sheets: Notes, Log; set table to one of them" in refusal(path, layout("excel", tmp_path, **keys))
    assert "no sheet 'Logs'; did you mean 'Log'?" in refusal(path, layout("excel", tmp_path, table="Logs", **keys))


def test_bad_cells_of_a_workbook_are_refused_by_row(tmp_path):
    path = xlsx(tmp_path, ("Log", [*PLAIN[:4], [0.01, "12,5"], [0.02, 13]]))
    message = refusal(path, load_layout("excel", Path()))
    assert (
        "line 5 column 'tension_cN': '12,5' is not a number; the layout says decimal = '.', did you mean ','?"
        in message
    )


# Damage, and the wrong layout.


def test_a_log_under_a_layout_of_another_kind_is_told_what_it_is(tmp_path):
    plain = load_layout("plain-csv", Path())
    assert 'it is a workbook, the layout reads text; write a layout with base = "excel"' in refusal(
        xlsx(tmp_path, ("Log", PLAIN)), plain
    )
    assert 'it is a TDMS file, the layout reads text; write a layout with base = "labview-tdms"' in refusal(
        tdms(tmp_path, TENSION), plain
    )
    text = lvm(tmp_path, "time_s,tension_cN\n0,1\n")
    assert "it cannot be read as a workbook (BadZipFile" in refusal(text, load_layout("excel", Path()))
    assert "it is no TDMS file: the first bytes are others" in refusal(text, load_layout("labview-tdms", Path()))
    assert "cannot be read (No such file" in refusal(tmp_path / "none.tdms", load_layout("labview-tdms", Path()))


@pytest.mark.parametrize("kind", ["labview-lvm", "labview-tdms", "excel"])
def test_damaged_logs_are_read_or_refused(tmp_path, kind):
    """Cut and flipped bytes of each kind: a result or one line, nothing else."""
    make = {
        "labview-lvm": lambda: lvm(tmp_path, HEADER + ROWS),
        "labview-tdms": lambda: tdms(tmp_path, TENSION),
        "excel": lambda: xlsx(tmp_path, ("Log", PLAIN)),
    }
    whole = make[kind]().read_bytes()
    chosen, path, rng = load_layout(kind, Path()), tmp_path / "damaged", random.Random(0)
    refusals = list[str]()
    for trial in range(300):
        data = bytearray(whole)
        if trial % 3 == 0:
            data = data[: rng.randrange(len(data))]
        else:
            for _ in range(rng.choice([1, 1, 4])):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        try:
            read_tension(path, chosen)
        except InputError as error:
            refusals.append(str(error))
    assert len(refusals) > 50
    assert all(one.startswith(str(path)) and "\n" not in one for one in refusals)
