"""The settings file: every key, what is refused, and by which name."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from coaxlink.cli import main
from coaxlink.errors import InputError
from coaxlink.monitor import config
from coaxlink.monitor.config import Config, load_config


def test_the_documented_example_has_every_key_and_is_taken(tmp_path: Path) -> None:
    example = re.sub(r"(?m)^    ", "", str(config.__doc__).partition("\n\n")[2])
    path = tmp_path / "monitor.toml"
    path.write_text(example)
    found = load_config(path)
    assert set(re.findall(r"(?m)^(\w+) =", example)) == set(config.KEYS) == set(Config.__dataclass_fields__)
    assert found.plot_s == 60.0 and found.airframe == tmp_path / "my_x8.toml"


def test_what_is_refused_is_named(tmp_path: Path) -> None:
    path = tmp_path / "monitor.toml"
    for line, said in (
        ("pag = 3", "pag: unknown; page?"),
        ("zzz = 1", "zzz: unknown; one of connect"),
        ("page = 3", "page: a text is expected, found 3"),
        ('page = "blue"', "page: one of split, error, parameters, messages, health is expected"),
        ("plot_s = 1e9", "plot_s: seconds from 2 to 600 are expected"),
        ("plot_s = nan", "plot_s: seconds from 2 to 600 are expected"),
        ("plot_s = true", "plot_s: seconds"),
        ("page", "not TOML"),
    ):
        path.write_text(line)
        with pytest.raises(InputError, match=re.escape(said)):
            load_config(path)


def test_the_usual_file_is_taken_when_it_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert load_config(None) == Config()
    (tmp_path / "coaxlink").mkdir()
    (tmp_path / "coaxlink" / "monitor.toml").write_text('page = "health"')
    assert load_config(None).page == "health"
    with pytest.raises(InputError, match="cannot be read"):
        load_config(tmp_path / "absent.toml")


def test_a_browser_needs_textual_serve(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "textual_serve.server", None)
    with pytest.raises(SystemExit, match="2"):
        main(["monitor", "--web", "--connect", "tcp:127.0.0.1:9"])
    said = capsys.readouterr().err
    assert said == (
        "coaxlink: --web: textual-serve is needed, which is not installed: pip install 'coaxlink[web]'\n"
    )
