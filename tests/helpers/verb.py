"""A verb run as a user runs it: its exit code, what it printed, what it said."""

import pytest

from coaxlink.cli import main


def run(capsys, *arguments):
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, arguments)))
    captured = capsys.readouterr()
    return ended.value.code, captured.out, captured.err
