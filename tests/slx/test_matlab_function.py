"""MATLAB Functions as blocks, beside Octave: branches, loops, persistent variables, classes and matrices over steps."""

import random
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from tests.slx.test_matlab import octave
from twodof.blocks import Bus, Diagram, Port
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.errors import DiagramError
from twodof.slx.matlab.function_block import MatlabFunction, last_index
from twodof.slx.translation import Signal

pytestmark = pytest.mark.slow

STEPS = 60
_CLASSES = {"real": "double", "bool": "logical"}


def drawn(signal: Signal, draw: np.random.Generator) -> np.ndarray:
    """Random inputs of a type, over the steps."""
    shape = (STEPS, *(signal.shape or (() if signal.width is None else (signal.width,))))
    if signal.kind == "real":
        return np.asarray(np.round(draw.normal(0.0, 2.0, shape), 2))
    if signal.kind == "bool":
        return np.asarray(draw.random(shape) < 0.5)
    limits = np.iinfo(signal.number)
    return draw.integers(limits.min, limits.max, shape, dtype=signal.number, endpoint=True)


def flown(code: str, signals: list[Signal], inputs: list[np.ndarray]) -> tuple[MatlabFunction, dict[str, np.ndarray]]:
    """The block of a function, and what its diagram gives after a round trip through JSON."""
    block = MatlabFunction(code, signals)
    d = Diagram("function")
    names = [f"in{k}" for k in range(len(signals))]
    for name, signal in zip(names, signals, strict=True):
        d.declare(signal.port(name))
    d.add("f", block, inputs=dict(zip([port.name for port in block.inputs], names, strict=True)))
    for port in block.outputs:
        d.output(port.name, f"f.{port.name}")
    program = build(from_json(to_json(d)), dt=0.01)
    return block, program.machine().run(STEPS, dict(zip(names, inputs, strict=True)))


def literal(value: np.ndarray, kind: str) -> str:
    """The MATLAB text of an array of one or two dimensions, or of a number; a vector is a column."""
    array = np.atleast_1d(value)
    rows = array.reshape(len(array), -1)
    text = ";".join(" ".join(f"{float(one):.17g}" for one in row) for row in rows)
    return f"{_CLASSES.get(kind, kind)}([{text}])"


def assert_octaves(code: str, signals: list[Signal], folder: Path, seed: int = 1) -> MatlabFunction:
    """Compare outputs and their classes with Octave's over the steps."""
    draw = np.random.default_rng(seed)
    inputs = [drawn(signal, draw) for signal in signals]
    block, found = flown(code, signals, inputs)
    results = [port.name for port in block.outputs]
    calls = [
        f"[{', '.join(f'r{k}' for k in range(len(results)))}] = f({', '.join(row)});"
        + "".join(f" Y{k}(end + 1, :) = double(r{k}(:)'); C{k} = class(r{k});" for k in range(len(results)))
        for row in zip(
            *([literal(v, s.number) for v in given] for given, s in zip(inputs, signals, strict=True)), strict=True
        )
    ]
    begin = "".join(f"Y{k} = [];" for k in range(len(results)))
    shown = [shown for k in range(len(results)) for shown in (f"Y{k}", f"C{k}")]
    answers = octave("\n".join([code, begin, *calls]), shown, folder)
    for k, port in enumerate(block.outputs):
        values, letters = answers[2 * k], answers[2 * k + 1]
        assert values is not None, code
        assert letters is not None
        assert "".join(map(chr, map(int, letters[1]))) == _CLASSES.get(port.kind, port.kind), port.name
        wanted = np.reshape(values[1], values[0], order="F")
        mine = found[port.name].astype(float)
        if port.shape is not None:
            mine = mine.transpose(0, 2, 1)  # column after column
        # Elementary functions, powers and solutions are those of two libraries, and states carry them on.
        assert np.allclose(mine.reshape(wanted.shape), wanted, rtol=1e-11, atol=1e-13, equal_nan=True), (
            port.name,
            code,
        )
    return block


REAL, VECTOR, MATRIX = Signal(), Signal("real", 3), Signal("real", 6, (2, 3))

BRANCHES = """function [y, n] = f(u, v)
% a comment with if and end
persistent x k
if isempty(x)
  x = 0; k = int8(120);
end
if u > 0 && v(1) < 1
  x = x + u;
elseif any(v > 2) || ~(u < -1)
  x = -1;
else
  x = x * 0.5;
end
k = k + 1;
y = zeros(1, 3);
for i = 1:3
  if v(2) > i, break; end
  if v(3) > i - 1
    continue
  end
  y(i) = g(x, i);
end
n = k;
end
function r = g(a, b)
r = a * b;
if a > 1
  return
end
r = r + 1;
end
"""

SWITCH = """function [y, z] = f(u, v)
m = mod(round(u), 5);
switch m
  case 0
    y = v(1);
  case {1, 2}
    y = v(2); if v(1) > 0, y = -y; end
  otherwise
    y = sum(v) + 7;
end
z = 0; k = 0;
while k < 4
  k = k + 1;
  if v(1) > k / 2, z = z + k; else, if u > 1, break, end, end
end
end
"""

INTEGERS = """function [a, b, c, d, e, g, h, k] = f(u, v, w, t)
a = u * v;
b = u / 3 + 2.5;
c = int32(w) - int32(u);
d = uint8(t * 100) + uint8(v);
e = bitand(w, uint16(255)) + bitshift(w, -3);
g = [u; v](1) == v || w > 1000;
h = int16(w) * 0.3 - int16(5);
k = double(-u) / 3 + mod(double(w), 7) + (t > 1) + true;
if ~g, a(1) = 3.7; end
end
"""

MATRICES = """function [P, y, e, s] = f(M, v, u)
persistent Q
if isempty(Q), Q = eye(3) * 2; end
A = [1 .1 0; 0 1 u/10; 0 0 1];
Q = A * Q * A' * .5 + diag([.1 .2 .3]);
S = M * Q * M' + eye(2);
K = (Q * M') / S;
P = K;
y = Q \\ v;
e = inv(S) * v(1:2) + S^-2 * v(2:3) + det(S(1:1, 1:1)) * [1; -1];
s = [sum(M(:)), norm(v), v' * v, max(v), min(v), mean(v), prod(v), cumsum(v)', trace(Q)];
y(end) = y(end) - dot(v, v) + sum(cross(v, [1; 2; 3]));
end
"""

INDICES = """function [a, b, c, d] = f(u, v, M)
i = 1 + mod(floor(abs(u)), 3);
a = v(i);
b = v; b(i) = 10; b(v > 1) = 0;
c = M(:, i) + M(1 + (u > 0), 1);
c(1 + (u > 1)) = u;
d = M; d(2, i) = -1; d(1, :) = [u; v(1:2)];
end
"""

FUNCTIONS = """function y = f(u, v)
[m, at] = max(v); [n, low] = min(abs(v));
[r, c] = size(v);
y = [m; at; n; low; r; c; mod(u, 2*pi); rem(u, .7); mod(-u, 3); mod(u, 0); rem(u*100, 7); mod(u / 0, .7);
     rem(u / 0, .7); mod(u * NaN, .7); fix(u); round(u); sign(v);
     atan2(u, v(1)); exp(u)^2; u^3; abs(u)^.5; 2^u; hypot(u, 3); tanh(u); max(u, NaN); min([NaN; v]); isnan(u / 0);
     max(v(1), v(2)); any(v > 1); all(v > -1); xor(u > 0, v(1) > 0); sqrt(abs(u)); floor(-u); ceil(u); numel(v);
     interp1([-1 0 2], [5 6 -2], max(min(u, 2), -1)); logical(v(1)); double(u > 0) * 2; cosh(u); deg2rad(u);
     filter([.5 .25 .125 2], 2, [v; u; -v])];
end
"""

EARLY = """function y = f(u)
persistent x last
y = 0;
if isempty(x)
  x = u; last = [u; 1];
  y = 100;
  return
end
for k = 1:numel(last)
  last(k) = last(k) + x / k;
  if last(k) > 3
    last(k) = 0;
    return;
  end
end
x = .9 * x + .1 * u;
y = x + last(1);
end
"""

LOOPS = """function [y, n, k] = f(u, v)
y = u; n = int16(0); k = uint8(200);
while y > 1
  y = y / 2 - .1; n = n + 1;
  if n == 5, continue; end
  k = k + 20;
  if v(1) > 1 && n > 2, break; end
end
while any(v > 0) && k > 5
  v = v - .25; k = k - 1;
end
m = 0;
while 1
  m = m + 1;
  if m > abs(y) + 3, break; end
end
while u > .5, y = y + m; break; end
end
"""

KEPT = """y = 0; while y < u, y = y + g(y); end
end
function r = g(x)
persistent n
if isempty(n), n = 0; end
n = n + 1; r = n;"""

BITS = """function [a, b, c, d, e, y] = f(u, v, w, s)
a = typecast([u; v], 'int16');
b = bitset(w, 3) - bitset(w, 5, 0);
c = uint16(bitget(w, 4)) + uint16(bitget(w, 16));
d = bitshift(w, mod(double(v), 40) - 20);
e = bitshift(s, -mod(double(v), 7));
y = 0; k = 0;
while k < 6 && y < double(u) / 16
  y = y + 2; k = k + 1;
  if k > double(v) / 30, break, end
end
end
"""

HANDLES = """function [y, z] = f(u, v)
k = 3; S = @(p) [0 -p(3) p(2); p(3) 0 -p(1); -p(2) p(1) 0];
k = 100; g = @(a, b) a * b + k * (a > 0 && b > 0);
h = @twice; c = {@sin, @(x) x + 1};
y = [S(v) * v; g(u, v(1)); h(u); feval(h, v(2)); feval('twice', 2 * u); applied(@(x) g(x, 2), u); c{2}(u); c{1}(u)];
[z, w] = applied(h, v(3)); z = z + w;
end
function r = twice(x)
persistent n
if isempty(n), n = 0; end
n = n + 1; r = 2 * x + n;
end
function [r, s] = applied(f, x)
r = f(x) - 1; s = f(r);
end
"""

ANGLES = """function y = f(u, v, q)
w = 97 * v; n = 90 * double(q);
y = [sind(w); cosd(w); tand(w); asind(v / 20); acosd(v / 20); atand(w); atan2d(u, v); sec(u); csc(u); cot(u);
     sind(n); cosd(n); sind(-n); cosd([30; 60; 180; 270]); sind(30); sind([NaN; Inf]); atan2d(-0, -1); tand(45)];
end
"""

MORE = """function y = f(u, v, M)
A = M * M' + eye(2); B = [v v([2 3 1]) v([3 1 2])]; P = B' * B + eye(3);
if ~isequal(size(real(A)), [2 2]), error('no'); end
k = find([0 3 0 -1]); w = tril(P) - triu(B, 1);
y = [norm(v, 1); norm(M, 'fro'); reshape(chol(A), [], 1); reshape(chol(P, 'lower'), [], 1); nnz(v > 0);
     nnz([v; 0; NaN]); realsqrt(u^2); linsolve(A, [u; 1]); v(k - 1); find([1; 0; 1], 1); numel(k); w(:);
     circshift(v, 1); horzcat(v', u)';
     isequal(v, v) + isequal(v, v'); isequal(floor(v), [0; 0; -1]); isequal(u, v); real(u);
     vertcat(v, u, 7); isreal(v) + isscalar(u) + isvector(v) + isrow(v) + iscolumn(v) + isnumeric(u);
     size(find(1 > 2))'];
end
"""

BASE = """
function [y, z] = f(u, v)
if evalin('base', 'exist(''kept'', ''var'') == 0')
  kept = zeros(5, 1);
else
  kept = evalin('base', 'kept');
end
kept = [kept(2:end); u];
assignin('base', 'kept', kept);
if u > 0, assignin('base', 'last', u); else, assignin('base', 'last', v(2)); end
y = sum(kept) + evalin('base', 'kept(1) - last');
z = 2 * kept;
end
"""

LATE = """
function [y, z] = f(u)
persistent k
if isempty(k), k = 0; end
k = k + 1;
if u > 0, y = first(u); else, y = count(u); end
z = u > -1 && count(u) > 3;
if k > 3, y = y + first(k) + first(u); end
end
function y = first(u)
persistent n m
if isempty(n), n = u; m = 7; end
if isempty(m), m = 100; end
m = m + 1;
y = n + m;
end
function y = count(u)
persistent n
if isempty(n), n = 0; end
n = n + 1;
y = n + u;
end
"""


@pytest.mark.parametrize(
    ("code", "signals"),
    [
        (LATE, [REAL]),
        (BASE, [REAL, VECTOR]),
        (HANDLES, [REAL, VECTOR]),
        (ANGLES, [REAL, VECTOR, Signal("int8")]),
        (MORE, [REAL, VECTOR, MATRIX]),
        (BRANCHES, [REAL, VECTOR]),
        (SWITCH, [REAL, VECTOR]),
        (INTEGERS, [Signal("int8"), Signal("int8"), Signal("uint16"), REAL]),
        (MATRICES, [MATRIX, VECTOR, REAL]),
        (INDICES, [REAL, VECTOR, MATRIX]),
        (FUNCTIONS, [REAL, VECTOR]),
        (EARLY, [REAL]),
        (LOOPS, [REAL, VECTOR]),
        ("function y = f(u)\nerror = u - 1; hold = u * 2;\ny = error + hold;\nend\n", [REAL]),
        (BITS, [Signal("uint8"), Signal("uint8"), Signal("uint16"), Signal("int32")]),
    ],
    ids=[
        "memory of functions called late",
        "memory in the base workspace",
        "handles",
        "angles",
        "more",
        "branches",
        "switch",
        "integers",
        "matrices",
        "indices",
        "functions",
        "early",
        "loops",
        "names of statements",
        "bits",
    ],
)
def test_a_function_has_octaves_values_at_each_step(code: str, signals: list[Signal], tmp_path: Path) -> None:
    assert_octaves(code, signals, tmp_path)


def test_constants_of_the_first_call_are_initial_values() -> None:
    block = MatlabFunction(BRANCHES, [REAL, VECTOR])
    assert [(s.name, s.initial, s.kind) for s in block.states] == [("f_x", 0.0, "real"), ("f_k", 120, "int8")]
    early = MatlabFunction(EARLY, [REAL])  # what the first call keeps hangs on its input
    assert [s.name for s in early.states] == ["f_x", "f_last", "was_called"]


def program(draw: random.Random, depth: int, loop: bool) -> list[str]:
    """Random statements on doubles a and b, a persistent p and a counter n."""
    made = []
    for _ in range(draw.randint(1, 3)):
        name, other = draw.choice("abpn"), draw.choice("abpnu")
        kind = draw.randrange(7 if depth else 2)
        condition = f"{draw.choice('abpu')} {draw.choice(['<', '>=', '>', '~='])} {draw.choice(['u', 'v', '.5', 'p'])}"
        if kind <= 2:
            change = f"{other} {draw.choice(['+', '-', '.*'])} {draw.choice(['u', 'v', '1.5', 'b'])}"
            made.append(f"{name} = max(min({change}, 50), -50);")
        elif kind <= 4:
            other_way = ["else", *program(draw, depth - 1, loop)] if draw.random() < 0.6 else []
            made += [f"if {condition}", *program(draw, depth - 1, loop), *other_way, "end"]
        elif kind == 5:
            made += [f"for k{depth} = 1:{draw.randint(1, 4)}", *program(draw, depth - 1, True), "end"]
        else:
            leave = draw.choice(["break", "continue", "return"] if loop else ["return"])
            made.append(f"if {condition}, {leave}; end")
    return made


def test_random_programs_have_octaves_values(tmp_path: Path) -> None:
    draw = random.Random(5)
    for seed in range(6):
        body = "\n".join(program(draw, 3, False))
        code = (
            "function [a, b, n, q] = f(u, v)\npersistent p\nif isempty(p), p = .25; end\n"
            f"a = u; b = v; n = 0; q = p;\n{body}\nq = p + a;\nend\n"
        )
        assert_octaves(code, [REAL, REAL], tmp_path, seed)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("g = @(a) a; y = g(u, u);", "line 2: the function takes 1 arguments and gives one value"),
        ("g = @(h) h(h); y = g(g) + u;", "functions call each other too deep"),
        ("y = [u; u] + [u; u; u];", "line 2: arrays of 2 by 1 and 3 by 1 do not fit each other"),
        ("g = @svd; y = g(u);", "line 2: svd is not computed"),
        ("y = quat2eul([u 0 0 1], 'XYZ');", "line 2: quat2eul_of_another_sequence is not computed"),
        ("y = svd(u);", "line 2: svd is not computed"),
        ("for k = 1:u, y = k; end", "line 2: a range whose bounds are signals"),
        ("while u(1) > 0, u = [u; 1]; end, y = u;", "line 2: u changes its size or class in a loop"),
        ("y = 0; s = 'a'; while y < u, y = y + 1; s = 'b'; end", "line 2: s changes in a loop .* and is no number"),
        (KEPT, "line 2: g.n is kept and begins in a loop"),
        ("y = 0; while 1, y = y + 1; if y > u, return; end, end", "line 2: a return that depends on signals"),
        ("if u > 0, y = 1; else, y = [1 2]; end", "line 2: y is 1 by 1 and 1 by 2 in two branches"),
        ("if u > 0, y = 1; else, y = true; end", "line 2: y is real and bool in two branches"),
        ("persistent p; y = p + u;", "line 2: p is read before it has a value"),
        ("persistent p; if isempty(p), p = 0; end\np = [p u]; y = 1;", "the persistent p changes its size"),
        ("global g; y = g;", "line 2: 'global' is not translated"),
        ("try, y = u; catch, y = 0; end", "line 2: 'try' is not translated"),
        ("if u > 0, y = u; if u > 1", "line 2: a block has no end"),
        ("y = int8(u) + int16(u);", "int16 and int8 in one operation"),
        ("y = f(u);", "functions call each other too deep"),
        ("v = u;", "the output y gets no value"),
        ("if u > 0, assignin('base', 'k', u); end\ny = u;", "line 2: k of the base workspace is there"),
        ("y = u + evalin('caller', 'k');", "line 2: evalin and assignin are translated for"),
        ("y = u + evalin('base', 'k');", "line 2: k has no value"),
        ("y = 0; for k = 1:1000000, y = y + k; end", "more than 50000 operations"),
    ],
)
def test_a_statement_that_is_not_translated_is_said_by_its_line(line: str, said: str) -> None:
    with pytest.raises(DiagramError, match=said.replace("(", r"\(")):
        MatlabFunction(f"function y = f(u)\n{line}\nend", [REAL])


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("y = u / 2;", "line 2: whole numbers of 64 bits are not computed"),
        ("y = [u; u]; y = y + 1;", "line 2: whole numbers of 64 bits are not computed"),
        ("y = [u; 1];", "line 2: a whole number of 64 bits beside others is not translated"),
        ("y = u; if v > 0, y = v; end", "line 2: y is real and float64 in two branches"),
    ],
)
def test_whole_numbers_of_64_bits_are_passed_on_and_not_computed(body: str, said: str) -> None:
    wide = Signal("float64")
    with pytest.raises(DiagramError, match=said):
        MatlabFunction(f"function y = f(u, v)\n{body}", [wide, REAL])
    block = MatlabFunction("function [y, z, n] = f(u)\ny = u; z = double(u) / 2; n = u > 3;", [wide])
    assert [port.kind for port in block.outputs] == ["float64", "real", "bool"]


def test_what_is_left_out_or_approximated_is_noted() -> None:
    block = MatlabFunction("function y = f(u)\ny = u;\nif u > 5, error('too much'); end", [REAL])
    assert block.notes == ["line 3: error() is left out"]
    block = MatlabFunction("function y = f(u)\ny = single(u) + zeros(1, 1, 'single');", [REAL])
    assert block.notes == ["single: computed in the precision of the build"]
    assert [port.kind for port in block.outputs] == ["real"]
    block = MatlabFunction("function [y, z] = f(u)\ny = [u u]; z = [u; u];", [REAL])
    assert block.notes == ["the row y is a vector, which other MATLAB Functions see as a column"]


def test_singles_of_a_bus_meet_doubles() -> None:
    bus = Bus("B", [Port("s", "float32")])
    block = MatlabFunction("function y = f(b, u)\ny = b.s * u;", [Signal(bus), Signal()])
    d = Diagram("of")
    d.input("b", bus)
    d.input("u")
    d.output("y", d.add("f", block, b="b", u="u"))
    found = build(d, dt=1.0).machine().step({"b": {"s": np.float32(0.1)}, "u": 0.3})
    assert found["y"] == float(np.float32(0.1)) * 0.3


def test_wrapped_angles_keep_the_sign_of_their_bound() -> None:
    given = np.array([0.0, -0.0, 90.0, 180.0, -180.0, 181.0, 360.0, -360.0, 540.0, -540.0, 720.0, -1.0, np.nan])
    inputs = [np.resize(given, STEPS)]
    _, found = flown("function [y, z] = f(u)\ny = wrapTo180(u); z = wrapTo360(u);", [REAL], inputs)
    nan, half = np.nan, [0.0, 0.0, 90.0, 180.0, -180.0, -179.0, 0.0, 0.0, 180.0, -180.0, 0.0, -1.0]
    whole = [0.0, 0.0, 90.0, 180.0, 180.0, 181.0, 360.0, 0.0, 180.0, 180.0, 360.0, 359.0]
    assert np.array_equal(found["y"][: len(given)], [*half, nan], equal_nan=True)
    assert np.array_equal(found["z"][: len(given)], [*whole, nan], equal_nan=True)
    radians = [np.deg2rad(one) for one in inputs]
    _, turned = flown("function [y, z] = f(u)\ny = wrapToPi(u); z = wrapTo2Pi(u);", [REAL], radians)
    assert np.allclose(np.rad2deg(turned["y"]), found["y"], equal_nan=True)
    assert np.allclose(np.rad2deg(turned["z"]), found["z"], equal_nan=True)


ANGLES_OF, QUATERNION, TURN = Signal("real", 3), Signal("real", 4), Signal("real", 9, (3, 3))


@pytest.mark.parametrize("sequence", ["ZYX", "XYZ", "ZYZ", "zxy"])
def test_angles_turn_about_the_axes_of_their_sequence(sequence: str) -> None:
    angles = np.random.default_rng(2).uniform(-1.5, 1.5, (STEPS, 3))
    turn = Rotation.from_euler(sequence.upper(), angles)
    code = f"""function [R, q, C, p] = f(a)
    R = eul2rotm(a', '{sequence}'); q = eul2quat(a', '{sequence}');
    C = angle2dcm(a(1), a(2), a(3), '{sequence}'); p = angle2quat(a(1), a(2), a(3), '{sequence}');"""
    _, found = flown(code, [ANGLES_OF], [angles])
    quaternion = turn.as_quat(scalar_first=True)
    assert np.allclose(found["R"], turn.as_matrix(), atol=1e-14)
    assert np.allclose(found["C"], turn.inv().as_matrix(), atol=1e-14)
    assert np.allclose(np.abs(np.sum(found["q"] * quaternion, axis=1)), 1.0, atol=1e-14)
    assert np.array_equal(found["p"], found["q"])


def test_rotations_and_quaternions_are_those_of_scipy() -> None:
    draw = np.random.default_rng(3)
    angles, (q, r), v = (
        draw.uniform(-1.5, 1.5, (STEPS, 3)),
        draw.normal(0.0, 2.0, (2, STEPS, 4)),
        np.eye(3)[[0, 1, 2] * 20],
    )
    turn = [Rotation.from_euler(one, angles).as_matrix() for one in ("ZYX", "XYZ")]
    code = "function [y, z] = f(a, b)\ny = rotm2eul(a); z = rotm2eul(b, 'XYZ');"
    _, found = flown(code, [TURN, TURN], turn)
    assert np.allclose(found["y"], angles, atol=1e-13)
    assert np.allclose(found["z"], angles, atol=1e-13)
    code = """function [R, e, p, i, t, n, C] = f(q, r, v)
    q = q'; R = quat2rotm(q); e = quat2eul(q); p = quatmultiply(q, r'); i = quatmultiply(quatinv(q), q);
    t = quatrotate(q, v'); n = [quatnorm(q), quatmod(q)^2, quatmod(quatnormalize(q)), quatconj(q)]; C = quat2dcm(q);"""
    _, found = flown(code, [QUATERNION, QUATERNION, ANGLES_OF], [q, r, v])
    one, other = (Rotation.from_quat(given, scalar_first=True) for given in (q, r))
    sizes = np.linalg.norm(q, axis=1)
    assert np.allclose(found["R"], one.as_matrix(), atol=1e-13)
    assert np.allclose(found["C"], one.inv().as_matrix(), atol=1e-13)
    assert np.allclose(found["e"], one.as_euler("ZYX"), atol=1e-12)
    assert np.allclose(found["i"], np.eye(4)[0], atol=1e-13)
    assert np.allclose(found["t"], one.inv().apply(v), atol=1e-13)
    assert np.allclose(found["n"], np.column_stack([sizes**2, sizes**2, sizes**0, q * [1, -1, -1, -1]]), atol=1e-12)
    product = (one * other).as_quat(scalar_first=True) * (sizes * np.linalg.norm(r, axis=1))[:, None]
    assert np.allclose(found["p"] * np.sign(found["p"][:, :1]), product * np.sign(product[:, :1]), atol=1e-12)


def test_angles_where_two_axes_meet_are_still_those_of_the_turn() -> None:
    angles = np.resize([[0.3, np.pi / 2, 0.5], [0.3, -np.pi / 2, 0.5]], (STEPS, 3))
    code = "function [R, S] = f(a)\nR = eul2rotm(a') - eul2rotm(rotm2eul(eul2rotm(a')));\n"
    code += "S = eul2rotm(a', 'XYZ') - eul2rotm(rotm2eul(eul2rotm(a', 'XYZ'), 'XYZ'), 'XYZ');"
    _, found = flown(code, [ANGLES_OF], [angles])
    assert np.allclose(found["R"], 0.0, atol=1e-14)
    assert np.allclose(found["S"], 0.0, atol=1e-14)


def test_the_width_of_an_argument_is_its_largest_index(tmp_path: Path) -> None:
    (tmp_path / "skew.m").write_text("function S = skew(w)\nS = [0 -w(3) w(2); w(3) 0 -w(1); -w(2) w(1) 0];")
    code = """function y = f(a, b, c, d, e, g)
    y = a(1:4)' + a(2) + b([1 2, 6]) + skew(c) * turned(1, d) + s.e(5) + e(1, 7) + g(12, 1);
    function r = turned(n, q)
    r = skew(q) + turned(q, n) + eul2quat(q) + q(4)';"""
    assert [last_index(code, k, [tmp_path]) for k in range(1, 8)] == [4, 6, 3, 4, 1, 12, 1]


def test_functions_of_files_beside_the_model_are_called(tmp_path: Path) -> None:
    (tmp_path / "smoothed.m").write_text(
        "function y = smoothed(u)\n% first order\npersistent x\nif isempty(x), x = 0; end\n"
        "x = .5 * x + half(u);\ny = x;\n\nfunction h = half(u)\nh = u / 2;\n",
        encoding="utf-8",
    )
    (tmp_path / "script.m").write_text("a = 1;", encoding="utf-8")
    block = MatlabFunction("function y = f(u)\ny = smoothed(u) + 1;", [REAL], folders=[tmp_path])
    assert [(s.name, s.initial) for s in block.states] == [("smoothed_smoothed_x", 0.0)]
    d = Diagram("d")
    d.input("u")
    d.add("f", block, u="u")
    d.output("y", "f.y")
    got = build(from_json(to_json(d)), dt=0.01).machine().run(3, {"u": np.array([2.0, 4.0, 0.0])})
    assert got["y"].tolist() == [2.0, 3.5, 2.25]
    with pytest.raises(DiagramError, match=r"line 2: script.m: there is no function in it"):
        MatlabFunction("function y = f(u)\ny = script(u);", [REAL], folders=[tmp_path])
    with pytest.raises(DiagramError, match="line 2: other is not computed"):
        MatlabFunction("function y = f(u)\ny = other(u);", [REAL], folders=[tmp_path])


def test_a_bus_is_a_structure() -> None:
    bus = Bus("Rates", [Port("p"), Port("q", width=2), Port("inner", Bus("Inner", [Port("n", "int8")]))])
    code = "function y = f(s, g)\ns.q(2) = s.q(2) + g;\nif s.p > 0, s.inner.n = int8(1); end\n"
    block = MatlabFunction(f"{code}y = [s.p; s.q; double(s.inner.n)];", [Signal(bus), REAL])
    d = Diagram("d")
    d.input("s", bus)
    d.input("g")
    d.add("f", block, s="s", g="g")
    d.output("y", "f.y")
    machine = build(from_json(to_json(d)), dt=0.01).machine()
    given = {"p": 1.0, "q": [2.0, 3.0], "inner": {"n": 7}}
    assert list(machine.step({"s": given, "g": 0.5})["y"]) == [1.0, 2.0, 3.5, 1.0]
    assert list(machine.step({"s": {**given, "p": -1.0}, "g": 0.5})["y"]) == [-1.0, 2.0, 3.5, 7.0]


def test_a_structure_is_a_bus_and_a_state_by_its_fields() -> None:
    code = """function [s, y] = f(u)
    persistent p
    if isempty(p), p.n = int8(3); p.at.x = 0; p.at.v = [1; 2]; end
    p.n = p.n + 1; p.at.x = p.at.x + u;
    if u > 0, p.at.v(1) = u; end
    s = p; s.at.x = -p.at.x; y = numel(fieldnames(p)) + isfield(p, 'n');
    end"""
    with pytest.raises(DiagramError, match="line 6: fieldnames is not computed"):
        MatlabFunction(code, [REAL])
    bus = Bus("Sent", [Port("at", Bus("At", [Port("x"), Port("v", width=2)])), Port("n", "int8")])
    block = MatlabFunction(code.replace("numel(fieldnames(p)) +", "p.at.v(1) *"), [REAL], buses={"s": bus})
    assert [(s.name, s.kind, s.initial) for s in block.states] == [
        ("f_p_n", "int8", 3), ("f_p_at_x", "real", 0.0), ("f_p_at_v", "real", [1.0, 2.0])
    ]  # fmt: skip
    assert [port.name for port in block.outputs] == ["s.at.x", "s.at.v", "s.n", "y"]
    d = Diagram("d")
    d.input("u")
    d.add("f", block, u="u")
    d.output("s", "f.s")
    d.output("y", "f.y")
    machine = build(from_json(to_json(d)), dt=0.01).machine()
    assert [machine.step({"u": u})["y"] for u in (-1.0, 5.0)] == [1.0, 5.0]
    found = machine.step({"u": 1.0})
    assert (found["s.at.x"], list(found["s.at.v"]), found["s.n"]) == (-5.0, [1.0, 2.0], 6)
    with pytest.raises(DiagramError, match="the fields of the output s are not those of the bus Sent"):
        MatlabFunction("function s = f(u)\ns.n = u;", [REAL], buses={"s": bus})


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("y = u; for i = 1:60\n y = [y; y];\n end", "takes more than 200000 operations on elements of signals"),
        ("A = ones(90, 90)*u; B = A*A; y = B(1, 1);", "takes more than 200000 operations on elements of signals"),
        ("y = u; for i = 1:300\n for j = 1:300\n y = y*1.1;\n end\n end", "takes more than 50000 operations"),
        ("y = u;\n" + "if u > 0\n" * 70 + "y = 1;\n" + "end\n" * 70, "blocks stand in each other too deep"),
        ("y = zeros(1e5, 1e5)*u;", "too many elements"),
        ("y = f(u);", "functions call each other too deep"),
        ("system('touch /tmp/x'); y = u;", "system is not computed"),
    ],
)
def test_a_function_without_end_is_refused(body: str, why: str) -> None:
    with pytest.raises(DiagramError, match=why):
        MatlabFunction(f"function y = f(u)\n{body}\n", [Signal()])


NESTED = """function y = f(u)
b = 3;
y = half(u) + b;
    function b = half(a)
        {} = 2; b = a / {};
    end
    {}
end"""


def test_a_function_in_another_one_has_variables_of_its_own() -> None:
    """MATLAB's documentation: only names that both use are shared, and arguments and results never are."""
    u = np.arange(STEPS) * 1.0
    assert np.array_equal(flown(NESTED.format("k", "k", ""), [Signal()], [u])[1]["y"], u / 2.0 + 3.0)


@pytest.mark.parametrize(
    ("words", "why"),
    [(("y", "y", ""), "half in f shares y with it"), (("k", "k", "y = 1;"), "before statements of it")],
)
def test_a_function_that_shares_variables_with_the_one_around_it_is_refused(words: tuple[str, ...], why: str) -> None:
    with pytest.raises(DiagramError, match=why):
        MatlabFunction(NESTED.format(*words), [Signal()])


def test_further_indices_of_a_matrix_are_1() -> None:
    code = "function y = f(u)\nm = zeros(2, 2, 1); m(:, :, 1) = [u(1) u(2); 3 4]; y = m(:, 2, :)' + size(u, 3);"
    u = np.arange(2.0 * STEPS).reshape(STEPS, 2)
    assert np.array_equal(flown(code, [Signal(width=2)], [u])[1]["y"], np.stack([u[:, 1] + 1.0, [5.0] * STEPS], axis=1))
    with pytest.raises(DiagramError, match="three dimensions"):
        MatlabFunction("function y = f(u)\nm = eye(2); y = m(1, 1, 2) * u;", [Signal()])


def test_cells_of_a_function_are_assigned_by_their_place() -> None:
    code = "function y = f(u)\nc = cell(2, 1); for k = 1:2, c{k} = k * u; end\ny = [c{2} c{1}]';"
    u = np.arange(STEPS) * 1.0
    assert np.array_equal(flown(code, [Signal()], [u])[1]["y"], np.stack([2.0 * u, u], axis=1))


def test_a_function_loads_numbers_and_cell_arrays_of_a_file(tmp_path: Path) -> None:
    savemat(tmp_path / "gains.mat", {"K": 4.0, "parts": np.array([[[1.0, 2.0]], [[5.0]]], dtype=object)})
    code = "function y = f(u)\npersistent g\nif isempty(g), g = load('gains.mat'); end\n"
    block = MatlabFunction(f"{code}y = u * g.K + g.parts{{2}} + g.parts{{1}}(2);", [Signal()], folders=[tmp_path])
    d = Diagram("loaded")
    d.input("u")
    d.add("f", block, u="u")
    d.output("y", "f.y")
    u = np.arange(STEPS) * 1.0
    assert np.array_equal(build(d, dt=0.01).machine().run(STEPS, {"u": u})["y"], 4.0 * u + 7.0)
    with pytest.raises(DiagramError, match=r"no_file\.mat is not found"):
        MatlabFunction("function y = f(u)\ng = load('no_file'); y = u * g.K;", [Signal()], folders=[tmp_path])


def test_a_rotation_matrix_gives_the_quaternion_of_scipy() -> None:
    """With a positive real part; one of them is the example in MathWorks' documentation."""
    turns = [*Rotation.random(STEPS - 4, random_state=5), *Rotation.from_euler("xyz", np.eye(3) * 3.1)]
    turns.append(Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    matrices = np.array([one.as_matrix() for one in turns])
    found = flown("function q = f(R)\nq = rotm2quat(R);", [Signal(shape=(3, 3), width=9)], [matrices])[1]["q"]
    wanted = np.array([one.as_quat(canonical=True)[[3, 0, 1, 2]] for one in turns])
    assert np.allclose(found, wanted, rtol=0.0, atol=1e-12)
    assert np.allclose(found[-1], [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], rtol=0.0, atol=1e-15)
