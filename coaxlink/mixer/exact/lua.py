"""The exact law written out as Lua: translated from its own source, so that it is not written twice.

The kernel is floats, indexing and loops, which Lua has too; its tables are indexed from 0 here, as Python's
lists. What an autopilot's script may spend is limited, so the sure ways through a hard problem stay at home:
within so many quadratic steps the law is at the optimum, as it is for every demand within reach that follows
the one before, or it says that it is not (`onboard.settle`).
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any

from coaxlink.mixer.exact import kernel, loads, onboard, quadratic, schur, warm

# callees before callers
FUNCTIONS: dict[ModuleType, tuple[str, ...]] = {
    loads: (
        "surface", "value", "line", "value_of_one", "expand_arm", "expand", "miss", "move", "largest_step",
        "worst_met",
    ),
    schur: ("reduce_arm", "assemble", "give_up", "factor", "substitute", "correct"),
    quadratic: ("step_arms", "revise", "quadratic_step"),
    warm: ("away", "keep", "recall", "start"),
    kernel: ("solve", "restart"),
    onboard: ("settle",),
}  # fmt: skip
# ArduPilot's Lua counts in single precision: 1e-6 of authority, under 1 mN, is what it can come to
SINGLE = {"MISS_ENOUGH": 3e-6}
NO_CLIMB = "local function climb() return 0 end"
_CALLS = {"min": "min", "max": "max", "abs": "abs", "sqrt": "sqrt", "int": "floor"}
_OPERATORS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "~=",
}  # fmt: skip


def law_in_lua() -> str:
    """The functions of the law, `settle` last; it takes the arrays of `ExactLaw.arrays` and a limit."""
    parts = ["local min, max, abs, sqrt, floor = math.min, math.max, math.abs, math.sqrt, math.floor"]
    parts.append(NO_CLIMB)
    for module, names in FUNCTIONS.items():
        parts += [translate(getattr(module, name), {**vars(module), **SINGLE}) for name in names]
    return "\n".join(parts) + "\n"


def table(value: Any) -> str:
    """A list, nested or not, as a Lua table from 0."""
    if isinstance(value, list):
        first, *rest = [table(v) for v in value]
        return f"{{ [0] = {first}, {', '.join(rest)} }}"
    return repr(value)


def translate(function: Callable[..., Any], names: dict[str, Any]) -> str:
    """One function; names of numbers in `names` become the numbers. Raises NotImplementedError."""
    (node,) = ast.parse(inspect.getsource(function)).body
    assert isinstance(node, ast.FunctionDef)
    return _Writer(node, names).text()


class _Writer:
    def __init__(self, node: ast.FunctionDef, names: dict[str, Any]) -> None:
        self._node = node
        self._arguments = [a.arg for a in node.args.args]
        assigned = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self._locals = sorted(assigned - set(self._arguments) - {"_"})
        hidden = assigned | set(self._arguments)
        self._numbers = {k: v for k, v in names.items() if type(v) in (int, float) and k not in hidden}
        self._truths = {
            n.targets[0].id
            for n in ast.walk(node)
            if isinstance(n, ast.Assign)
            and isinstance(n.value, ast.BoolOp)
            and isinstance(n.targets[0], ast.Name)
        }
        self._labels = 0

    def text(self) -> str:
        lines = [f"local function {self._node.name}({', '.join(self._arguments)})"]
        if self._locals:
            lines.append(f"  local {', '.join(self._locals)}")
        body = self._node.body
        if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body = body[1:]
        lines += self._block(body, 1, "")
        return "\n".join([*lines, "end"])

    def _block(self, body: list[ast.stmt], depth: int, label: str) -> list[str]:
        out: list[str] = []
        for statement in body:
            out += self._statement(statement, "  " * depth, depth, label)
        return out

    def _statement(self, s: ast.stmt, pad: str, depth: int, label: str) -> list[str]:
        e = self._expression
        if isinstance(s, ast.Return):
            # `do` because Lua wants a return to end its block
            return [f"{pad}do return {self._list(s.value) if s.value else ''} end"]
        if (
            isinstance(s, ast.Assign)
            and isinstance(s.value, ast.IfExp)
            and isinstance(s.value.body, ast.Tuple)
        ):
            way = s.value
            branches = [[ast.Assign(s.targets, v)] for v in (way.body, way.orelse)]
            return self._statement(ast.If(way.test, branches[0], branches[1]), pad, depth, label)  # type: ignore[arg-type]
        if isinstance(s, ast.Assign):
            value = self._list(s.value)
            if len(s.targets) == 1:
                return [f"{pad}{self._list(s.targets[0])} = {value}"]
            names = [self._list(t) for t in s.targets]  # a = b = 0.0
            return [f"{pad}{', '.join(names)} = {', '.join([value] * len(names))}"]
        if isinstance(s, ast.AugAssign):
            return [f"{pad}{e(s.target)} = {e(s.target)} {_OPERATORS[type(s.op)]} ({e(s.value)})"]
        if isinstance(s, ast.Expr):
            return [f"{pad}{e(s.value)}"]
        if isinstance(s, ast.If):
            out = [f"{pad}if {self._test(s.test)} then", *self._block(s.body, depth + 1, label)]
            if s.orelse:
                out += [f"{pad}else", *self._block(s.orelse, depth + 1, label)]
            return [*out, f"{pad}end"]
        if isinstance(s, ast.For | ast.While):
            return self._loop(s, pad, depth)
        if isinstance(s, ast.Break):
            return [f"{pad}break"]
        if isinstance(s, ast.Continue):
            return [f"{pad}goto {label}"]
        raise NotImplementedError(ast.dump(s))

    def _loop(self, s: ast.For | ast.While, pad: str, depth: int) -> list[str]:
        self._labels += 1
        label = f"next_{self._labels}"
        if isinstance(s, ast.While):
            head = f"while {self._test(s.test)} do"
        else:
            head = f"for {self._expression(s.target)} = {self._range(s.iter)} do"
        body = self._block(s.body, depth + 1, label)
        if any(f"goto {label}" in line for line in body):
            body.append(f"{pad}  ::{label}::")
        return [pad + head, *body, f"{pad}end"]

    def _range(self, node: ast.expr) -> str:
        assert isinstance(node, ast.Call)
        given = [self._expression(a) for a in node.args]
        if len(given) == 1:
            return f"0, {given[0]} - 1"
        if len(given) == 2:
            return f"{given[0]}, {given[1]} - 1"
        return f"{given[0]}, {given[1]} + 1, {given[2]}"  # downwards

    def _list(self, node: ast.expr) -> str:
        if isinstance(node, ast.Tuple):
            return ", ".join(self._expression(x) for x in node.elts)
        return self._expression(node)

    def _expression(self, node: ast.expr) -> str:
        e = self._expression
        if isinstance(node, ast.Constant):
            return repr(node.value)
        if isinstance(node, ast.Name):
            return repr(self._numbers[node.id]) if node.id in self._numbers else node.id
        if isinstance(node, ast.Subscript):
            return f"{e(node.value)}[{e(node.slice)}]"
        if isinstance(node, ast.BinOp):
            return f"({e(node.left)} {_OPERATORS[type(node.op)]} {e(node.right)})"
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return f"(-{e(node.operand)})"
        if isinstance(node, ast.IfExp):  # a number is true in Lua whatever it is
            return f"({self._test(node.test)} and {e(node.body)} or {e(node.orelse)})"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id == "len":
                return f"(#{e(node.args[0])} + 1)"
            name = _CALLS.get(node.func.id, node.func.id)
            return f"{name}({', '.join(e(a) for a in node.args)})"
        if isinstance(node, ast.Compare | ast.BoolOp):
            return self._test(node)
        raise NotImplementedError(ast.dump(node))

    def _test(self, node: ast.expr) -> str:
        """As a truth: 0 is false in Python, not in Lua."""
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            pairs = zip(sides, node.ops, sides[1:], strict=False)
            tests = [
                f"{self._expression(a)} {_OPERATORS[type(op)]} {self._expression(b)}" for a, op, b in pairs
            ]
            return f"({' and '.join(tests)})"
        if isinstance(node, ast.BoolOp):
            word = " and " if isinstance(node.op, ast.And) else " or "
            return f"({word.join(self._test(v) for v in node.values)})"
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f"not {self._test(node.operand)}"
        if isinstance(node, ast.Name) and node.id in self._truths:
            return node.id
        return f"({self._expression(node)} ~= 0)"
