"""Layouts: what they accept, and that each mistake is refused in one line that says what would be right."""

from pathlib import Path

import pytest

from pipeline.errors import InputError
from pipeline.ingest.layouts import load_layout, newtons_per, packaged_layouts

MINIMAL = 'decimal = "."\ntime_column = "t"\ntension_column = "F"\nunit = "cN"\n'


def write(folder: Path, text: str) -> Path:
    (folder / "my.toml").write_text(text, encoding="utf-8")
    return folder


def test_packaged_layouts_load_and_only_the_self_defined_ones_claim_to_be_verified():
    known = ["eltex-th", "excel", "german-semicolon", "labview-lvm", "labview-tdms", "plain-csv"]
    assert packaged_layouts() == known
    layouts = {name: load_layout(name, Path()) for name in packaged_layouts()}
    assert all(layout.name == name and layout.note for name, layout in layouts.items())
    assert [name for name, layout in layouts.items() if layout.verified] == ["excel", "plain-csv"]


def test_a_few_lines_make_a_layout(tmp_path):
    layout = load_layout("my.toml", write(tmp_path, MINIMAL + "resolution_cN = 0.1\ncalibration_u_percent = 1\n"))
    assert (layout.name, layout.delimiter, layout.resolution_cN, layout.calibration_u_percent) == (
        "my.toml",
        ",",
        0.1,
        1,
    )


def test_base_takes_a_packaged_layout_but_not_its_claims(tmp_path):
    layout = load_layout("my.toml", write(tmp_path, 'base = "plain-csv"\nunit = "mN"\n'))
    assert (layout.time_column, layout.unit, layout.verified, layout.note) == ("time_s", "mN", False, "")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (MINIMAL + 'delimeter = ";"\n', "my.toml key 'delimeter': unknown key; did you mean 'delimiter'?"),
        (MINIMAL + 'name = "x"\n', "key 'name': unknown key"),
        (MINIMAL.replace('"."', '";"'), "key 'decimal': is ';'; it should be '.' or ','"),
        (
            MINIMAL.replace('unit = "cN"\n', 'unit = "lbf"\n'),
            "'lbf' is not a known unit of tension; known: cN, N, mN, gf, g",
        ),
        (MINIMAL.replace('unit = "cN"\n', ""), "the unit must come from one place; give unit"),
        (MINIMAL + "count_full_scale = 4095\n", "the unit must come from one place; give unit"),
        (MINIMAL + "rate_Hz = 100\n", "time must come from one place; give either time_column or rate_Hz"),
        (MINIMAL.replace('time_column = "t"\n', ""), "time must come from one place"),
        (MINIMAL.replace('decimal = "."\n', ""), "key 'decimal': is missing"),
        (MINIMAL + 'encoding = "cp12525"\n', "encoding = 'cp12525' is not known; try 'utf-8-sig'"),
        (MINIMAL + 'delimiter = "."\n', "delimiter and decimal are the same character"),
        (MINIMAL + "resolution_cN = -0.1\n", "key 'resolution_cN': is -0.1; it should be greater than 0"),
        (MINIMAL + 'units_row = "yes"\n', "key 'units_row': is 'yes'; it should be a valid boolean"),
        (MINIMAL + 'columns = ["t", "G"]\n', "tension_column = 'F' is not among columns"),
        (MINIMAL + 'columns = ["t", "F"]\nunits_row = true\n', "units_row follows a header row"),
        ('base = "plain-cvs"\n', "key 'base': 'plain-cvs' is not a packaged layout; did you mean 'plain-csv'?"),
        (MINIMAL + 'table = "Log"\n', "table = 'Log', but a text log has one; leave it out"),
        (MINIMAL + 'format = "xls"\n', "key 'format': is 'xls'; it should be 'text', 'lvm', 'tdms' or 'xlsx'"),
        ("decimal = .\n", "not a TOML file in UTF-8"),
    ],
)
def test_mistakes_are_refused_by_name(tmp_path, text, says):
    with pytest.raises(InputError) as refused:
        load_layout("my.toml", write(tmp_path, text))
    assert says in str(refused.value)
    assert "my.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_unknown_layout_lists_the_known_ones(tmp_path):
    with pytest.raises(
        InputError, match=r"layout 'honigmann': no such layout; give a \.toml file or one of: eltex-th,"
    ):
        load_layout("honigmann", tmp_path)
    with pytest.raises(InputError, match=r"absent\.toml: cannot be read"):
        load_layout("absent.toml", tmp_path)


def test_units_of_tension():
    # 1 gf = 0.980665 cN exactly.
    assert newtons_per("gf", "x") == pytest.approx(0.00980665, rel=1e-15)
    assert newtons_per("g", "x") == newtons_per("gf", "x")
    assert newtons_per("kgf", "x") == 9.80665
    assert [newtons_per(unit, "x") for unit in ("[cN]", "(N)", " mN ")] == [0.01, 1.0, 0.001]
    with pytest.raises(InputError, match="known: cN, N, mN"):
        newtons_per("CN", "x")
