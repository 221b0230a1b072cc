import sys
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from pipeline import cli


@dataclass(frozen=True)
class Ran:
    """What a command did, as a shell sees it."""

    code: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line of an input error."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        return lines[0]


@pytest.fixture
def yarnval(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Run `yarnval` with arguments; a traceback fails the test by itself."""

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["yarnval", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        captured = capsys.readouterr()
        code = stop.value.code
        assert isinstance(code, int)
        return Ran(code, captured.out, captured.err)

    return run
