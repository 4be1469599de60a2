"""Term names and polynomials, against arithmetic by hand."""

import numpy as np
import pytest

from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.rotor import Polynomial, load_rotor_model
from coaxlink.rotor.polynomial import design_matrix, dictionary, parse_term, term_name


def test_names_are_powers():
    names = {"1": (0, 0), "u_u": (1, 0), "u_l^2": (0, 2), "u_u^2 u_l": (2, 1), "u_u u_u": (2, 0)}
    assert {name: parse_term(name) for name in names} == names
    assert all(parse_term(term_name(*powers)) == powers for powers in names.values())
    for name in ("", "x", "u_u**2", "2 u_u", "u_u^-1", "u_u^999999999", "u_u^12 u_u"):
        with pytest.raises(ValueError, match=r"term|powers"):
            parse_term(name)


def test_values_and_slopes():
    p = Polynomial.from_terms({"u_u^2": 3.0, "u_u u_l": -2.0, "1": 0.5})
    assert p(2.0, 5.0) == pytest.approx(3 * 4 - 2 * 10 + 0.5)
    assert p.derivative("u_u")(2.0, 5.0) == pytest.approx(6 * 2 - 2 * 5)
    assert p.derivative("u_l")(2.0, 5.0) == pytest.approx(-4.0)
    assert p.scaled(2.0)(2.0, 5.0) == pytest.approx(2 * (3 * 4 - 2 * 10 + 0.5))


def test_the_design_has_a_column_a_term():
    X = design_matrix(dictionary(1, 1), [2.0, 3.0], [5.0, 7.0])
    np.testing.assert_allclose(X, [[1, 5, 2, 10], [1, 7, 3, 21]])


def test_a_rotor_file_with_an_absurd_number_is_refused_by_key(tmp_path):
    text = example("rotor_paper.toml").read_text()
    path = tmp_path / "rotor.toml"
    path.write_text(text.replace("55.9517", "1e300"))
    with pytest.raises(InputError, match=r"rotor\.toml: upper\.thrust_N\.u_u\^2: .*1e\+300"):
        load_rotor_model(path)


def test_a_rotor_file_of_a_form_that_is_no_longer_made_still_loads(tmp_path):
    """Its polynomials are all that is used: the form is a label."""
    path = tmp_path / "rotor.toml"
    path.write_text(example("rotor_paper.toml").read_text().replace('form = "crm"', 'form = "mutual"'))
    model = load_rotor_model(path)
    assert model.form == "mutual" and model.terms() == load_rotor_model(example("rotor_paper.toml")).terms()
