"""QGroundControl's parameter files, read and written."""

import numpy as np
import pytest

from firmware_params import px4

GOOD = "# Vehicle-Id 1\n#\n1\t1\tCA_ROTOR_COUNT\t8\t6\n1\t1\tCA_ROTOR0_CT\t46.979999542236328125\t9\n"


def test_reads_what_qgc_writes(tmp_path):
    path = tmp_path / "a.params"
    path.write_text(GOOD)
    read = px4.read_params_file(path)
    assert read.params == {"CA_ROTOR_COUNT": 8, "CA_ROTOR0_CT": 46.979999542236328125}
    assert read.types == {"CA_ROTOR_COUNT": 6, "CA_ROTOR0_CT": 9}
    assert (read.system, read.component, read.header[0]) == (1, 1, "Vehicle-Id 1")


def test_every_float32_comes_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(5)
    bits = rng.integers(0, 2**32, 3000, dtype=np.uint32).view(np.float32)
    values = [float(v) for v in bits if np.isfinite(v)] + [0.0, -0.0, 1e-45, 6.5, 0.1]
    params = {f"P{i}": v for i, v in enumerate(values)}
    path = tmp_path / "b.params"
    px4.write_params_file(path, params)
    read = px4.read_params_file(path).params
    got = np.array([read[name] for name in params], np.float32)
    assert (got.view(np.uint32) == np.array(values, np.float32).view(np.uint32)).all()


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("1\t1\tCA_ROTOR0_CT\tnan\t9", "line 2: CA_ROTOR0_CT: a finite number"),
        ("1\t1\tCA_ROTOR0_CT\tx\t9", "line 2: CA_ROTOR0_CT: a number is expected, found 'x'"),
        ("1\t1\tCA_ROTOR_COUNT\t8.5\t6", "line 2: CA_ROTOR_COUNT: an integer"),
        ("1\t1\tCA_ROTOR_COUNT\t8\t9", "line 2: CA_ROTOR_COUNT: type 6 is expected"),
        ("1 1 CA_ROTOR_COUNT 8 6", "line 2: 5 tab-separated fields"),
        ("1\t1\tA\t1\t6\n1\t1\tA\t1\t6", "line 3: A stands twice"),
        ("1\t1\tA\t1\t6\n2\t1\tB\t1\t6", "line 3: 2/1 beside"),
        ("", "no parameters"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, text):
    path = tmp_path / "c.params"
    path.write_text(f"# head\n{line}\n")
    with pytest.raises(px4.ParamsFileError, match=text):
        px4.read_params_file(path)
