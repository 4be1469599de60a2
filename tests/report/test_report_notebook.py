"""What a notebook shows: the printed form and a picture, whole."""

from coaxlink.files import example
from coaxlink.rotor import load_rotor_model


def test_a_model_shows_its_equations_and_a_picture():
    model = load_rotor_model(example("rotor_paper.toml"))
    shown = model._repr_html_()
    assert all(line.split(" = ")[0] in shown for line in str(model).splitlines())
    assert shown.count('src="data:image/png;base64,') == 1 and shown.endswith('">')
