"""Reading logs: the real samples, each kind of time and unit, every refusal by its text, and round trips."""

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import InputError
from pipeline.ingest.layouts import Layout, load_layout
from pipeline.ingest.tension import read_tension
from pipeline.records import TensionFlag

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "logs"
PLAIN = load_layout("plain-csv", Path())
GERMAN = load_layout("german-semicolon", Path())


def layout(**keys):
    return Layout.model_validate({"name": "test", "decimal": ".", "tension_column": "F", "time_column": "t"} | keys)


def write(folder, content, encoding="utf-8"):
    path = folder / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def refusal(path, layout, **kw):
    with pytest.raises(InputError) as refused:
        read_tension(path, layout, **kw)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def sample(name):
    path = SAMPLES / name
    if not path.exists():
        pytest.skip(f"samples folder missing: {name}")
    return path


# Real samples.


def test_eltex_excerpt_from_the_manual(tmp_path):
    path = sample("eltex_TH_manual_excerpt.csv")
    (tmp_path / "mine.toml").write_text('base = "eltex-th"\nfull_scale_cN = 50\n')
    mine = load_layout("mine.toml", tmp_path)
    raw = read_tension(path, mine, root=path.parent.parent)
    assert raw.source.name == "logs/eltex_TH_manual_excerpt.csv"
    assert raw.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert raw.unit_in_file == "counts"
    # First and last row by hand: 2714 and 15085 of 65535 counts of 50 cN; 0.3723156597 − 0.3723070139 days.
    assert raw.tension[0] == pytest.approx(2714 / 65535 * 0.5, rel=1e-12)
    assert raw.tension[-1] == pytest.approx(15085 / 65535 * 0.5, rel=1e-12)
    assert raw.time[0] == 0
    assert raw.time[-1] == pytest.approx(8.6458e-6 * 86400, abs=1e-5)
    assert raw.resolution == pytest.approx(0.5 / 65535)
    assert raw.tension.size == 7
    assert not raw.flag.any()
    fifth = read_tension(path, mine, channel="Sensor 5")
    assert fifth.tension[3] == pytest.approx(393 / 65535 * 0.5, rel=1e-12)
    assert fifth.metadata["channel"] == "Sensor 5"


def test_eltex_counts_without_the_range_are_refused():
    message = refusal(sample("eltex_TH_manual_excerpt.csv"), load_layout("eltex-th", Path()))
    assert (
        'counts up to 65535 whose range is not stated; write a layout with base = "eltex-th" and full_scale_cN'
        in message
    )


def test_a_channel_that_is_not_there_names_the_nearest():
    path = sample("eltex_TH_manual_excerpt.csv")
    message = refusal(path, load_layout("eltex-th", Path()), channel="Sensor 6")
    assert "line 1: no column 'Sensor 6'; did you mean 'Sensor 5'?" in message


def test_matolab_sample_holds_a_preamble_only_and_is_refused():
    message = refusal(
        sample("matolab_example3.csv"), layout(delimiter="\t", time_column="Zeit", tension_column="Kraft", unit="N")
    )
    assert "no header row with 'Zeit' and 'Kraft' in 133 lines" in message


# Layout features.


def test_german_preamble_decimal_commas_and_tokens(tmp_path):
    path = write(
        tmp_path,
        '"Prüfer";"Jörg Müller"\r\nGerät;125.12\r\nDatum: 01.02.2024\r\n\r\n"Zeit [s]";"Fadenzugkraft [cN]"\r\n'
        "0,00;12,3\r\n0,01;---\r\n0,02;OVERLOAD\r\n0,03;\r\n0,04;-0,2\r\n0,05;100,0\r\n0,06;12\r\n\r\n",
        "cp1252",
    )
    raw = read_tension(path, GERMAN, root=tmp_path)
    np.testing.assert_allclose(raw.tension, [0.123, np.nan, np.nan, np.nan, -0.002, 1.0, 0.12], rtol=1e-14)
    np.testing.assert_allclose(raw.time, np.arange(7) / 100, atol=1e-12)
    missing, saturated, negative = TensionFlag.MISSING, TensionFlag.SATURATED, TensionFlag.NEGATIVE
    assert raw.flag.tolist() == [0, missing, saturated, missing, negative, saturated, 0]
    assert raw.resolution == 0.001
    assert math.isnan(raw.calibration_u)
    assert raw.metadata == {
        "Prüfer": "Jörg Müller",
        "Gerät": "125.12",
        "Datum": "01.02.2024",
        "first time stamp": "0,00",
        "channel": "Fadenzugkraft [cN]",
    }


@pytest.mark.parametrize(
    ("unit", "newtons"),
    [("cN", 0.01), ("N", 1), ("mN", 0.001), ("gf", 0.00980665), ("g", 0.00980665), ("kgf", 9.80665)],
)
def test_units_by_name(tmp_path, unit, newtons):
    fixed = read_tension(write(tmp_path, "t,F\n0,2.5\n1,3\n"), layout(unit=unit))
    row = read_tension(write(tmp_path, f"t,F\ns,[{unit}]\n0,2.5\n1,3\n"), layout(units_row=True))
    column = read_tension(write(tmp_path, f"t,F,u\n0,2.5,{unit}\n1,3,{unit}\n"), layout(unit_column="u"))
    for raw in (fixed, row, column):
        np.testing.assert_allclose(raw.tension, [2.5 * newtons, 3 * newtons], rtol=1e-14)
        assert raw.unit_in_file == unit


def test_a_unit_per_row(tmp_path):
    raw = read_tension(write(tmp_path, "t,F,u\n0,12,cN\n1,,\n2,10,gf\n"), layout(unit_column="u"))
    np.testing.assert_allclose(raw.tension, [0.12, np.nan, 0.0980665], rtol=1e-14)
    assert raw.unit_in_file == "cN, gf"


@pytest.mark.parametrize(
    ("kind", "stamps", "more"),
    [
        ("seconds", ("5.0", "5.5", "7.0"), {}),
        ("milliseconds", ("100", "600", "2100"), {}),
        ("datetime", ("2024-02-01T23:59:59.5", "2024-02-02T00:00:00", "2024-02-02T00:00:01.5"), {}),
        ("datetime", ("2024-02-01 10:00:00+01:00", "2024-02-01 10:00:00.5+01:00", "2024-02-01 10:00:02+01:00"), {}),
        ("datetime", ("12:00:01.250", "12:00:01.750", "12:00:03.250"), {"time_format": "%H:%M:%S.%f"}),
    ],
)
def test_kinds_of_time(tmp_path, kind, stamps, more):
    path = write(tmp_path, "t,F\n" + "".join(f"{stamp},1\n" for stamp in stamps))
    raw = read_tension(path, layout(unit="N", time_kind=kind, **more))
    np.testing.assert_allclose(raw.time, [0, 0.5, 2.0], atol=1e-12)
    assert raw.metadata["first time stamp"] == stamps[0]


def test_rate_instead_of_a_time_column_and_no_header(tmp_path):
    path = write(tmp_path, "made by hand\n1.5\n\n2.5\n3.5\n")
    raw = read_tension(path, layout(time_column="", rate_Hz=50, columns=["F"], skip_lines=1, unit="cN"))
    np.testing.assert_allclose(raw.time, [0, 0.02, 0.04])
    np.testing.assert_allclose(raw.tension, [0.015, 0.025, 0.035])


def test_fixed_number_of_preamble_lines_and_quoted_numbers(tmp_path):
    path = write(tmp_path, 't;F\n"a; b"\nt;F\n"0,0";"1,5"\n"0,5";"2,5"\n')
    raw = read_tension(path, layout(decimal=",", delimiter=";", unit="cN", skip_lines=2))
    np.testing.assert_allclose(raw.tension, [0.015, 0.025])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings_and_line_ends(tmp_path, encoding):
    for end in ("\n", "\r\n", "\r"):
        path = write(tmp_path, f"Prüfer: ö{end}t,F{end}0,1{end}1,2{end}", encoding)
        raw = read_tension(path, layout(unit="cN", encoding="utf-8-sig" if encoding == "utf-8" else encoding))
        assert raw.tension.tolist() == [0.01, 0.02]
        assert raw.metadata["Prüfer"] == "ö"


# Truncated files.


@pytest.mark.parametrize("last", ["0.0", "0.02", "0.02,", "0.02,1", "0.02,12", "0.02,12.", "0.02,x"])
def test_a_cut_last_line_is_kept_and_flagged(tmp_path, last):
    raw = read_tension(write(tmp_path, f"time_s,tension_cN\n0.00,12.1\n0.01,12.2\n{last}"), PLAIN)
    assert raw.flag.tolist() == [0, 0, TensionFlag.MISSING]
    np.testing.assert_allclose(raw.time, [0, 0.01, 0.02])
    np.testing.assert_allclose(raw.tension, [0.121, 0.122, np.nan])


def test_a_whole_last_line_without_line_end_is_read(tmp_path):
    raw = read_tension(write(tmp_path, "time_s,tension_cN\n0.00,12.1\n0.01,12.2"), PLAIN)
    assert raw.tension.tolist() == pytest.approx([0.121, 0.122])
    assert not raw.flag.any()


def test_a_file_cut_inside_a_character_or_a_quote(tmp_path):
    half = "t,F\n0,1\n1,2\n".encode("utf-16")[:-1]
    assert read_tension(write(tmp_path, half), layout(unit="N", encoding="utf-16")).tension.tolist() == [1, 2]
    quoted = write(tmp_path, 't;F\n"0,0";"1,5"\n"0,5";"2,5"\n"1,0";"2')
    raw = read_tension(quoted, layout(unit="N", delimiter=";", decimal=","))
    assert raw.flag.tolist() == [0, 0, TensionFlag.MISSING]


# Refusals.


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("0.00;12,3\n", "line 2 column 'time_s': '0.00;12' is not a number"),
        (
            "0.00,12.3\n0.01,abc\n0.02,1\n",
            "line 3 column 'tension_cN': 'abc' is not a number; give a number with decimal mark '.'",
        ),
        ("0.00,12.3\n0.01,nan\n", "line 3 column 'tension_cN': 'nan' is not a number"),
        ("0.00,12.3\n0.01,inf\n", "line 3 column 'tension_cN': 'inf' is not a number"),
        ("0.00,12.3\n0.01,1e999\n", "line 3 column 'tension_cN': '1e999' is not a number"),
        ("0.00,12.3\n\nx,12.3\n", "line 4 column 'time_s': 'x' is not a number"),
        ("0.00,12.3\n,12.3\n", "line 3 column 'time_s': '' is not a number"),
        ('0.00,12.3\n0.01,"12,3"\n', "'12,3' is not a number; the layout says decimal = '.', did you mean ','?"),
        ('0.00,12.3\n0.01,"1,234.5"\n', "'1,234.5' is not a number; thousands separators are not read"),
        ("0,00,12,3\n", "line 2: 4 fields, the header has 2; is ',' the decimal mark here too?"),
        ("0.00,1\n0.01\n0.02,1\n", "line 3: 1 fields, the header has 2; complete or remove this line"),
        ('0.00,1\n0.01,"1\n0.02,1\n0.03,1"\n0.04,1\n', "line 3: a quote is opened and not closed"),
        ('"0.00,1\n0.01,1\n0.02",1\n', "line 2: a quote is opened and not closed"),
        ('0.00,"' + "1" * 200_000 + "\n", "cannot be split into fields (field larger than field limit"),
        ("0.00,1\0\n0.01,1\n", "line 2 column 'tension_cN'"),
        ("", "no data after line 1; give a log with at least one sample"),
        ("\n\n", "no data after line 1"),
        ("0.00,\n0.01,\n", "column 'tension_cN': no reading in any row"),
    ],
)
def test_bad_data_is_refused_by_line_and_column(tmp_path, body, says):
    assert says in refusal(write(tmp_path, "time_s,tension_cN\n" + body), PLAIN)


@pytest.mark.parametrize(
    ("content", "keys", "says"),
    [
        (b"", {}, "the file is empty"),
        ("Prüfer\nt,F\n0,1\n".encode("cp1252"), {}, "line 1: byte 0xfc is not utf-8-sig; set the layout's encoding"),
        (
            "t,F\n0,1\n".encode("utf-16"),
            {},
            'byte-order mark of utf-16, the layout says utf-8-sig; set encoding = "utf-16"',
        ),
        ("t,F\n0,1\n".encode("utf-8-sig"), {"encoding": "cp1252"}, 'set encoding = "utf-8-sig"'),
        (b"time,F\n0,1\n", {}, "line 1: no column 't'; known: F, time"),
        (b"t,Force\n0,1\n", {"tension_column": "Forces"}, "line 1: no column 'Forces'; did you mean 'Force'?"),
        (b"t;F\n0;1\n", {}, "no header row with 't' and 'F' in 3 lines split at ','; check the layout's delimiter"),
        (b"t,F,F\n0,1,1\n", {}, "line 1: 2 columns 'F'; give each column its own name"),
        (
            b"t,F\ns,lbf\n0,1\n",
            {"unit": "", "units_row": True},
            "line 2 column 'F': 'lbf' is not a known unit of tension; known: cN",
        ),
        (b"t,F\ns,N\n0,1\n", {"units_row": True}, "line 2 column 'F': unit 'N'; the layout reads it as 'cN'"),
        (
            b"t,F [N]\n0,1\n",
            {"tension_column": "F [N]"},
            "line 1 column 'F [N]': unit 'N'; the layout reads it as 'cN'",
        ),
        (b"t,F,u\n0,1,cN\n1,1,\n", {"unit": "", "unit_column": "u"}, "line 3 column 'u': '' is not a known unit"),
        (b"t,F\n0,1\n", {"skip_lines": 9}, "the file has 3 lines; the layout puts the header on line 10"),
        (
            b"t,F\n1.2.24,1\n",
            {"time_kind": "datetime"},
            "line 2 column 't': '1.2.24' is not such a time; the layout says time_format",
        ),
    ],
)
def test_bad_files_are_refused(tmp_path, content, keys, says):
    assert says in refusal(write(tmp_path, content), layout(**({"unit": "cN"} | keys)))


def test_decimal_point_under_a_decimal_comma_layout(tmp_path):
    path = write(tmp_path, "Zeit [s];Fadenzugkraft [cN]\n0,0;12.3\n", "cp1252")
    message = refusal(path, GERMAN)
    assert (
        "line 2 column 'Fadenzugkraft [cN]': '12.3' is not a number; the layout says decimal = ',', did you mean '.'?"
        in message
    )


def test_no_such_file(tmp_path):
    assert "cannot be read" in refusal(tmp_path / "absent.csv", PLAIN)
    assert "cannot be read" in refusal(tmp_path, PLAIN)


# Round trips: what was written in a packaged layout is read back, to the rounding of the text.

READING = st.one_of(st.integers(-50, 999), st.sampled_from(["missing", "overload"]))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    readings=st.lists(READING, min_size=1, max_size=40),
    style=st.sampled_from(["plain-csv", "german-semicolon", "eltex-th"]),
)
def test_round_trip_in_each_packaged_layout(tmp_path, readings, style):
    """Readings in tenths of a cN (counts for the Eltex), 10 ms apart."""
    tokens = {"plain-csv": ("", ""), "german-semicolon": ("---", "OVERLOAD"), "eltex-th": ("", "")}[style]
    token = {"missing": tokens[0], "overload": tokens[1]}
    number = {
        "plain-csv": lambda r: f"{r / 10:.1f}",
        "german-semicolon": lambda r: f"{r / 10:.1f}".replace(".", ","),
        "eltex-th": str,
    }[style]
    cells = [token[r] if isinstance(r, str) else number(r) for r in readings]
    header, row = {
        "plain-csv": ("time_s,tension_cN", lambda i, c: f"{i / 100:.2f},{c}"),
        "german-semicolon": (
            "Gerät;x\nZeit [s];Fadenzugkraft [cN]",
            lambda i, c: f"{i / 100:.2f};{c}".replace(".", ",", 1),
        ),
        "eltex-th": ("Time;Sensor 1", lambda i, c: f"{40896 + i / 100 / 86400:.10f};{c}".replace(".", ",", 1)),
    }[style]
    kept = load_layout(style, Path())
    if style == "eltex-th":
        kept = kept.model_copy(update={"full_scale_cN": 6553.5})
    path = write(tmp_path, "\n".join([header, *(row(i, c) for i, c in enumerate(cells)), ""]), kept.encoding)
    if all(isinstance(r, str) for r in readings):
        assert "no reading in any row" in refusal(path, kept)
        return
    raw = read_tension(path, kept)
    expected = np.array([np.nan if isinstance(r, str) else r / 1000 for r in readings])
    np.testing.assert_allclose(raw.tension, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(raw.time, np.arange(len(readings)) / 100, atol=2e-5 if style == "eltex-th" else 1e-12)
    over = [bool(tokens[1]) and r == "overload" for r in readings]
    missing = [isinstance(r, str) and not o for r, o in zip(readings, over, strict=True)]
    assert (raw.flag & TensionFlag.SATURATED != 0).tolist() == over
    assert (raw.flag & TensionFlag.MISSING != 0).tolist() == missing
