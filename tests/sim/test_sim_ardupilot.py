"""The stand-in ArduCopter: pymavlink and MAVSDK talk to it, scripts bring it tables, it flies them."""

import re
import struct
import zlib
from pathlib import Path

import pytest

from firmware_params.ardupilot.scripts import loader_params, loader_script, matrix_script
from sim.ardupilot.copter import GUIDED, Copter
from sim.ardupilot.files import MANNERS
from sim.ardupilot.logger import DataFlashLogger
from sim.line.ftp import Server
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Goal, Refused
from sim.truth import Truth
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
REDUCED = [
    (s * 0.336, p * 0.336, y * 0.5, 0.672) if k < 4 else (s * 0.5, p * 0.5, y * 0.41, 1.0)
    for k, (s, p, y) in enumerate(
        [(-1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, -1, -1), (1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1)]
    )
]


class Board:
    """A Copter with files, without a wire."""

    def __init__(self) -> None:
        plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(EXAMPLES / "rotor_paper.toml"))
        self.copter = Copter(plant, Truth())
        self.reported: list[str] = []
        self.copter.say = lambda severity, text: self.reported.append(text)

    def boot_with(self, frame: int, **scripts: str) -> None:
        c = self.copter
        c.store.write("SCR_ENABLE", 1)
        c.store.write("FRAME_CLASS", frame)
        c.files.folders.add("scripts")
        c.files.files = {f"scripts/{name}.lua": text.encode() for name, text in scripts.items()}
        c.boot()

    def run(self, seconds: float) -> None:
        for _ in range(round(250 * seconds)):
            self.copter.step()

    def hover(self) -> list[float]:
        c = self.copter
        c.set_ap_mode(GUIDED)
        c.arm()
        c.take_off(3.0)
        self.run(8.0)
        return c.outputs_us


@pytest.fixture
def board() -> Board:
    return Board()


def split(us: list[float], board: Board) -> float:
    """Lower over upper thrust command."""
    mix = board.copter.mixer.mix
    thrust = [mix.thrust_of((p - 1000) / 1000) for p in us]
    return float(sum(thrust[4:]) / sum(thrust[:4]))


@pytest.mark.slow
def test_the_built_in_frame_flies_equal_motors(board: Board) -> None:
    us = board.hover()
    assert max(us) - min(us) < 25 and -board.copter.plant.position[2] == pytest.approx(3.0, abs=0.2)


def test_a_matrix_script_needs_a_reboot_and_flies_its_ratio(board: Board) -> None:
    pytest.importorskip("lupa")
    script = matrix_script(REDUCED, title="test")
    board.copter.files.files["scripts/coaxlink.lua"] = script.encode()
    assert board.copter.mixer.mix.factors.shape == (8, 4)
    board.boot_with(15, coaxlink=script)
    assert any("matrix of 8 motors" in text for text in board.reported)
    assert split(board.hover(), board) == pytest.approx(1 / 0.672, rel=0.02)


def test_without_its_script_a_matrix_frame_does_not_arm(board: Board) -> None:
    board.boot_with(15)
    with pytest.raises(Refused, match="frame class"):
        board.hover()


@pytest.mark.parametrize(
    ("script", "error"),
    [
        ("this is not Lua", "syntax error|unexpected|near"),
        ("no_such:call()", "no_such"),
        ("while true do end", "exceeded time limit"),
        ("return function() error('later') end, 10", "later"),
        ("io.open('x')", "io"),
    ],
)
def test_a_script_with_an_error_is_caught(board: Board, script: str, error: str) -> None:
    pytest.importorskip("lupa")
    board.boot_with(4, bad=script)
    board.run(0.1)
    assert any(re.search(f"Lua: .*({error})", text) for text in board.reported), board.reported
    with pytest.raises(Refused, match="Scripting"):
        board.copter.arm()


def test_the_checksum_keeps_altered_scripts_from_arming(board: Board) -> None:
    pytest.importorskip("lupa")
    script = matrix_script(REDUCED, title="test")
    crc = zlib.crc32(script.encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF
    board.copter.store.write("SCR_LD_CHECKSUM", float(crc & 0x7FFFFF))
    board.boot_with(15, coaxlink=script)
    board.copter.arm()
    board.copter.disarm()
    board.boot_with(15, coaxlink=script.replace("test", "tess"))
    with pytest.raises(Refused, match="CRC"):
        board.copter.arm()


@pytest.mark.slow
def test_a_loader_takes_a_new_table_in_flight(board: Board) -> None:
    pytest.importorskip("lupa")
    equal = [(r / abs(r) * 0.5, p / abs(p) * 0.5, y / abs(y) * 0.5, 1.0) for r, p, y, _ in REDUCED]
    board.boot_with(17, coaxlink=loader_script())
    for name, value in loader_params(equal).items():
        assert board.copter.store.write(name, value), name
    board.run(0.5)
    assert split(board.hover(), board) == pytest.approx(1.0, rel=0.02)
    for name, value in loader_params(REDUCED).items():
        board.copter.store.write(name, value)
    board.run(4.0)
    assert split(board.copter.outputs_us, board) == pytest.approx(1 / 0.672, rel=0.02)
    assert -board.copter.plant.position[2] == pytest.approx(3.0, abs=0.3)
    sum_before = board.copter.store["CXL_SUM"]
    board.boot_with(17, coaxlink=loader_script())
    assert board.copter.store["CXL_SUM"] == sum_before  # the table is there again after a reboot


def test_a_script_may_hold_outputs_for_a_while(board: Board) -> None:
    pytest.importorskip("lupa")
    text = """
    local n = 0
    function update()
      n = n + 1
      if n < 20 and arming:is_armed() then
        for k = 0, 7 do SRV_Channels:set_output_pwm_chan_timeout(k, 1580, 100) end
      end
      return update, 10
    end
    return update()
    """
    board.copter.arm()
    board.boot_with(4, hold=text)
    board.copter.arm()
    board.run(0.1)
    assert board.copter.outputs_us == [1580.0] * 8
    board.run(0.4)
    assert board.copter.outputs_us != [1580.0] * 8


@pytest.mark.slow
def test_a_set_point_before_it_is_up_ends_a_take_off(board: Board) -> None:
    """As mode_guided.cpp, flown on the real one: another submode, which does not leave the ground."""
    c = board.copter
    c.set_ap_mode(GUIDED)
    c.arm()
    c.take_off(3.0)
    board.run(0.1)
    c.offboard(Goal((0.0, 0.0, -3.0)))
    board.run(5.0)
    assert c.landed and c.armed
    c.take_off(3.0)
    board.run(8.0)
    assert not c.landed and c.plant.position[2] < -2.5


@pytest.mark.slow
def test_its_log_goes_on_for_a_while_after_disarming(board: Board) -> None:
    logger, c = DataFlashLogger(board.copter), board.copter
    c.arm()

    def grown(seconds: float) -> int:
        for _ in range(round(250 * seconds)):
            c.step()
            logger.record(round(1e6 * c.plant.time_s))
        return sum(len(c.files.files[path]) for path in logger.logs())

    flown = grown(1.0)
    c.disarm()
    persists = grown(14.0)
    over = grown(2.0)
    assert persists > 5 * flown and over < 1.1 * persists and grown(2.0) == over


def ftp(server: Server, sent: list[bytes], seq: int, code: int, data: bytes = b"", offset: int = 0) -> bytes:
    server.hear(struct.pack("<HBBBBBBI", seq, 0, code, len(data), 0, 0, 0, offset) + data.ljust(239, b"\0"))
    return sent[-1]


def test_files_over_mavlink(board: Board) -> None:
    sent: list[bytes] = []
    store, files = board.copter.store, board.copter.files
    files.folders.add("scripts")
    server = Server(files, MANNERS, sent.append)
    text = bytes(range(256)) * 3
    assert ftp(server, sent, 1, 6, b"/APM/scripts/a.lua")[3] == 128
    for k in range(0, len(text), 200):
        assert ftp(server, sent, 2 + k, 7, text[k : k + 200], k)[3] == 128
    ftp(server, sent, 900, 1)
    assert files.files["scripts/a.lua"] == text
    crc = ftp(server, sent, 901, 14, b"scripts/a.lua")
    assert struct.unpack_from("<I", crc, 12)[0] == zlib.crc32(text, 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert b"Fa.lua\t768" in ftp(server, sent, 902, 3, b"/APM/scripts")
    assert ftp(server, sent, 903, 4, b"/nothing")[3] == 129
    count = len(sent)
    ftp(server, sent, 903, 4, b"/nothing")
    assert len(sent) == count + 1 and sent[-1] == sent[-2]  # a repeated request gets the same answer
    assert ftp(server, sent, 904, 16, b"/APM/scripts")[3] == 129 and sent[-1][12] == 1  # Fail, not unknown
    before = store.values()
    packed = store.packed()
    head = struct.pack("<HHH", 0x671B, len(store.names), len(packed))
    store.write("MOT_THST_EXPO", 0.1)
    assert store.unpack(head + packed[6:]) and store.values() == before
    assert not store.unpack(head + packed[6:-1])
