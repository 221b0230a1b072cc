"""Machine code kept on disk is not run once a source file changed that it was made from."""

import subprocess
import sys
from pathlib import Path

OUTER = """\
from models.compiled import compiled
from kernels.inside import number


@compiled
def answer():
    return number()


print(answer())
"""
INSIDE = """\
from models.compiled import inner


@inner
def number():
    return {number}
"""
ROOT = Path(__file__).parents[2]


def test_a_change_in_another_file_is_seen(tmp_path: Path) -> None:
    package = tmp_path / "kernels"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "outer.py").write_text(OUTER)
    seen = []
    for number in (1, 2):
        (package / "inside.py").write_text(INSIDE.format(number=number))
        begin = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(tmp_path)!r}]; import kernels.outer"
        ran = subprocess.run([sys.executable, "-c", begin], capture_output=True, text=True, check=True, cwd=tmp_path)
        seen.append(ran.stdout.strip())
    assert seen == ["1", "2"]
    assert len(list((package / "__pycache__").glob("kernels-*"))) == 2
