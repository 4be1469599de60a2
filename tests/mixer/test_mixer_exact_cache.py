"""The compiled law is kept by its own source, so that an upgrade never runs an old one."""

from pathlib import Path

from coaxlink.mixer.exact import compiled, warm


def test_the_folder_follows_the_source_of_every_module(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = compiled.cache_folder()
    assert first == compiled.cache_folder()
    assert first.is_relative_to(tmp_path)
    edited = tmp_path / "warm.py"
    edited.write_text(Path(str(warm.__file__)).read_text() + "\n")
    monkeypatch.setattr(warm, "__file__", str(edited))
    assert compiled.cache_folder() != first
