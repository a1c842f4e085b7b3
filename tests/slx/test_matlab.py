"""The MATLAB subset: beside Octave on random expressions and scripts, and within bounds on hostile ones."""

import math
import random
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests import toolchains
from tests.patience import PATIENCE_S
from twodof.blocks.bus import Bus
from twodof.errors import DiagramError
from twodof.slx.data_types import kind_of
from twodof.slx.matlab.parser import assigned_names
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.script import run
from twodof.slx.matlab.values import Value, number

pytestmark = pytest.mark.slow

SCRIPT = """
A = [1 -2; 3, 4]';  % comment
g.Kp = 2*pi; g.v(3) = 5 ...
 + 1;
share = 1 * strcmp(sprintf('50%%'), '50%');
short = [1 0] + (false && unknown(3) || true || [1 unknown]);
x = A(end,:) * [1;2]
z = eye(2)*1e-3 + diag([1 2]);
[rows] = size([1 2; 3 4; 5 6], 1); [g.sum] = sum([1 2 3]);
n = numel(0:0.1:1); m = -2^2; b = 2^-1; c=[1 - 2, 3 -1]; d=~(1==2) && true; e = [g.v(1:end-1) 1]';
i = int8(200)+int8(1); j=single(1)/3; k = int32(7)/int32(2); l = uint8(3) - 5; o = 7*int16(-2.5);
%{
x = 5;
%}
r = [1,2
3,4]; t=r(:)'; u = r(2); p = r(:,1); q = r(end); s = mod(-7, 3) + rem(-7, 3);
B(2,3) = 7; B(1,:) = [1 2 3]; v = B'; w = sum(B) ; y = max(B(:)) + min([4 2]); h = [1:3] .^ 2;
a1 = 1:0; a2 = numel(a1); a3 = [A; 5 6]; a4 = A \\ [1; 2]; a5 = [1 2] / A; a6 = A^2; a7 = 2.^[1 2 3];
a8 = !true | 0; a9 = 3 ~= 4; b1 = round(-2.5) + fix(-2.7) + floor(-2.2); b2 = linspace(0, 1, 5); b3 = -[1 2](1);
b4 = [1 2]'; b5 = reshape(1:6, 2, 3); b6 = repmat([1 2], 2, 2); b7 = norm([3 4]); b8 = atan2(1, -1);
b9 = kron([1 2], [1;1]);
c0 = 5; c1 = B([1; 2]); c2 = B(B > 2); c3 = c0([1; 1]); c4 = u([1 1]); c5 = A([1 2; 3 4]); c6 = [4 5 6]([1 2; 3 1]);
c7 = h(h > 1); c8 = B([true false true]); c9 = B(:, [true false true]);
"""


def octave(code: str, shown: list[str], folder: Path) -> list[tuple[list[int], list[float]] | None]:
    """Run `code` in Octave, and return size and elements of the expressions `shown`; None where it refuses one."""
    lines = [
        f"try, V = {line}; printf('%d ', size(V)); printf(':'); printf(' %.17g', double(V)); printf('\\n');"
        " catch, printf('refused\\n'); end"
        for line in shown
    ]
    script = folder / "script.m"
    script.write_text("\n".join(["1; warning('off', 'all');", code, *lines]), encoding="utf-8")
    toolchains.need("octave-cli")
    command = ["octave-cli", "--no-init-file", "--no-gui", "--quiet", str(script)]
    answer = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    ).stdout.splitlines()
    found: list[tuple[list[int], list[float]] | None] = []
    for line in answer[len(answer) - len(shown) :]:
        size, _, values = line.partition(":")
        wanted = [int(n) for n in size.split()] if values or ":" in line else []
        found.append(None if line == "refused" else (wanted, [float(n) for n in values.split()]))
    return found


def assert_equal(mine: object, theirs: tuple[list[int], list[float]], what: str) -> None:
    array = np.asarray(mine)
    assert list(array.shape) == theirs[0], what
    values = array.astype(float).flatten(order="F")
    # Powers and elementary functions are those of two libraries: one unit in the last place each, twice over.
    assert np.allclose(values, theirs[1], rtol=1e-14, atol=1e-300, equal_nan=True), what


def expression(draw: random.Random, depth: int) -> str:
    """A random expression of scalars and small matrices; some are wrong in their sizes."""
    kind = draw.randrange(9) if depth else 0
    inner = [expression(draw, depth - 1) for _ in range(3)] if depth else []
    if kind <= 1:
        return draw.choice(
            ["2", ".5", "3e-1", "x", "A", "v", "A(2,:)", "v(end)", "pi", "s.k", "[1 -2]", "v'", "(-3)", "true"]
        )
    if kind == 2:
        operator = draw.choice(["+", " - ", ".*", "*", " ./ ", "/", ".^", "<=", "==", "&", "|", "~="])
        return f"({inner[0]}{operator}{inner[1]})"
    if kind == 3:
        return f"({draw.choice('-~+')}{inner[0]})"
    if kind == 4:
        return f"[{inner[0]}{draw.choice([' ', ', ', '; '])}{inner[1]}]"
    if kind == 5:
        function = draw.choice(["abs", "sin", "exp", "sum", "max", "numel", "floor", "sign", "isempty", "cumsum"])
        return f"{function}({inner[0]})"
    if kind == 6:
        return f"({inner[0]})'"
    if kind == 7:
        return f"({inner[0]}:{draw.choice(['', '.5:', '2:'])}{inner[1]})"
    return f"{draw.choice(['max', 'min', 'mod', 'atan2', 'rem'])}({inner[0]}, {inner[1]})"


def test_random_expressions_have_octaves_values(tmp_path: Path) -> None:
    draw = random.Random(2)
    workspace: dict[str, object] = {}
    given = "x = 1.5; A = [1 2; -.5 3]; v = [2 0 -1]; s.k = .25;"
    assert run(given, workspace) == []
    lines = [expression(draw, draw.randint(1, 4)) for _ in range(1500)]
    compared = refused = 0
    for line, theirs in zip(lines, octave(given, lines, tmp_path), strict=True):
        try:
            mine = evaluate(line, workspace)
        except DiagramError as error:
            refused += theirs is not None and "complex" not in error.what
            continue
        if theirs is not None:  # Octave refuses functions and ranges of logical values, which MATLAB does not
            assert_equal(mine, theirs, line)
            compared += 1
    assert compared > 1000
    assert refused < 15


def test_a_script_has_octaves_values(tmp_path: Path) -> None:
    workspace: dict[str, object] = {}
    assert run(SCRIPT, workspace) == []
    names = sorted(name for name, value in workspace.items() if isinstance(value, np.ndarray) and name != "ans")
    assert len(names) > 40
    for name, theirs in zip(names, octave(SCRIPT, names, tmp_path), strict=True):
        assert theirs is not None, name
        assert_equal(workspace[name], theirs, name)


def test_a_function_knows_how_many_results_are_asked_for(tmp_path: Path) -> None:
    """As in Octave 7.3: 10, then 20 and 21."""
    (tmp_path / "two.m").write_text("function [a, b] = two()\na = 10 * nargout; b = 1 + a;\nend\n", encoding="utf-8")
    names: dict[str, Value] = {}
    assert run("one = two(); [x, y] = two();", names, [tmp_path]) == []
    assert [np.asarray(names[name]).tolist() for name in ("one", "x", "y")] == [[[10.0]], [[20.0]], [[21.0]]]


def test_a_table_of_a_csv_file_is_grouped(tmp_path: Path) -> None:
    """A function finds the table in its folder; equal keys are averaged, as Octave does by unique and accumarray."""
    table = "\ufefftime,signal,thrust\n0,1200,3\n1,1000,2\n2,1200,5e0\n3,1100,-1\n4,1000,7\n"
    (tmp_path / "thrust test.csv").write_text(table, encoding="utf-8")
    (tmp_path / "uneven.csv").write_text(table.replace("1000,2", "1000,,2"), encoding="utf-8")
    (tmp_path / "column.csv").write_text("head\n1\n2\n", encoding="utf-8")
    code = """function [keys, of] = grouped(file)
    data = readtable(file);
    [keys, ~, at] = unique(data{:, 2});
    of = accumarray(at, data{:, 3}, [], @mean); plot(keys, of); title('thrust');
    end"""
    (tmp_path / "grouped.m").write_text(code, encoding="utf-8")
    names: dict[str, Value] = {}
    script = "[keys, of] = grouped('thrust test.csv'); sums = accumarray([2; 1; 2], [1; 2; 3]);\n"
    assert (
        run(script + "[c, first] = unique([3 1 3 2]); [none, x] = grouped('/etc/x.csv');", names, [tmp_path])[0].line
        == 2
    )
    assert [np.asarray(names[one]).flatten().tolist() for one in ("keys", "of", "sums", "c", "first")] == [
        [1000.0, 1100.0, 1200.0], [4.5, -1.0, 4.0], [2.0, 4.0], [1.0, 2.0, 3.0], [2.0, 4.0, 1.0],
    ]  # fmt: skip
    skipped = run(
        "d = csvread('column.csv'); n = accumarray([2; 1; 2], 1);\nd = csvread('column.csv', 1, 0);\n"
        "d = csvread('uneven.csv');\nd = filter([1 1], 1, [1 2; 3 4]);\nd = accumarray([1; 2], [1; 1], [5 1]);\n"
        "d = unique([3 NaN 1]);",
        names := {},
        [tmp_path],
    )
    assert np.asarray(names["n"]).tolist() == [[1.0], [2.0]]
    assert [one.line for one in skipped] == [2, 3, 4, 5, 6]
    assert "different numbers of columns" in skipped[1].why
    assert run("d = csvread('column.csv');", names, [tmp_path]) == []
    assert np.asarray(names["d"]).tolist() == [[1.0], [2.0]]


def test_what_is_not_computed_is_said_by_line_and_leaves_no_old_value() -> None:
    workspace: dict[str, object] = {"h": np.ones((1, 1))}
    skipped = run(
        "a = 1;\nsystem('rm -rf /');\nh = load('x.mat');\n[t, x] = ode45('rhs', [0 1], [1; 2]);\n"
        "for k = 1:3\n  a = fopen(k);\nend\nclear all\nb = a + 1;",
        workspace,
    )
    assert [(one.line, one.why) for one in skipped] == [
        (2, "system is not computed"),
        (3, "x.mat is not found"),
        (4, "ode45 is not computed"),
        (6, "fopen is not computed"),
        (9, "a has no value"),  # the loop may have changed it
    ]
    assert set(workspace) == set()


def test_a_script_runs_files_of_its_folders_alone(tmp_path: Path) -> None:
    """Fibonacci numbers: 1, 1, 2, 3, 5, ... from a function in a file, a loop, another script and a .mat file."""
    (tmp_path / "next.m").write_text("function [c, d] = next(a, b)\n c = b;\n d = a + b;\n", encoding="utf-8")
    (tmp_path / "start.m").write_text("a = 1; b = 1;\nload limits\n", encoding="utf-8")
    (tmp_path / "again.m").write_text("again\n", encoding="utf-8")
    savemat(tmp_path / "limits.mat", {"count": 8.0})
    (tmp_path.parent / "outside.m").write_text("secret = 1;", encoding="utf-8")
    code = """start
same = load('limits.mat'); count = same.count;
draw = rand(3, 1); draw = all(draw > 0 & draw < 1) + (draw(1) ~= draw(2));
for k = 1:count
  [a, b] = next(a, b);
  if b > 20, break, end
end
again
run('../outside.m')
switch k
  case 6, text = 'six';
  otherwise, text = 'another';
end
return
a = 0;"""
    workspace: dict[str, object] = {}
    skipped = run(code, workspace, [tmp_path])
    assert [one.line for one in skipped] == [3, 8, 9]
    assert skipped[0].why == "rand gives a fixed draw"
    assert "again.m, line 1: " in skipped[1].why
    assert "scripts run each other too deep" in skipped[1].why
    assert skipped[2].why == "../outside.m is not found"
    values = {name: value.item() for name, value in workspace.items() if isinstance(value, np.ndarray)}
    assert values == {"a": 13.0, "b": 21.0, "k": 6.0, "count": 8.0, "draw": 2.0}
    assert workspace["text"] == "six"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("zeros(1e6, 1e6)", "too many elements"),
        ("1:1e12", "too many elements"),
        ("ones(1000, 1) * ones(1, 10000)", "more than 1000000"),
        ("(" * 5000 + "1" + ")" * 5000, "nested too deep"),
        ("[" * 5000 + "1" + "]" * 5000, "nested too deep"),
        ("+".join(["1"] * 60_000), "more than 50000 operations"),
        ("system('reboot')", "system is not computed"),
        ("eval('1')", "eval is not computed"),
        ("fopen('/etc/passwd')", "fopen is not computed"),
        (r"sprintf('\q')", "sprintf of a value is not computed"),
        ("sprintf('gain %d')", "sprintf of a value is not computed"),
        ("__import__('os')", "is not read"),
        ("sqrt(-1)", "complex numbers"),
        ("kron(ones(1000), ones(1000))", "kron|more than"),
        ("repmat(1, 1e5, 1e5)", "too many elements"),
    ],
)
def test_hostile_text_ends_within_bounds(text: str, said: str) -> None:
    begin = time.process_time()
    with pytest.raises(DiagramError, match=said):
        evaluate(text, {})
    assert time.process_time() - begin < 5.0


def test_blank_lines_of_a_function_take_no_time() -> None:
    begin = time.process_time()
    assert run("function f\n" + 300_000 * "\n" + "x = 1;", {}) == []
    assert time.process_time() - begin < 5.0


def test_a_parameter_object_counts_as_its_value() -> None:
    workspace: dict[str, object] = {}
    assert run("P = Simulink.Parameter(.5); P.DataType = 'single';", workspace) == []
    assert math.isclose(float(np.asarray(number(workspace["P"])).item()), 0.5)


def test_an_assignment_to_nothing_names_nothing() -> None:
    assert assigned_names("= 3; k = 4;\nif = 2") == {"k"}


def test_a_script_may_end_with_a_word_and_skips_a_block_whole(tmp_path: Path) -> None:
    (tmp_path / "first.m").write_text("a = 1;\nfigure")
    names: dict[str, object] = {}
    assert [one.line for one in run("try\n b = 2;\nend\nif none, c = 3; end\nfirst", names, [tmp_path])] == [1, 4]
    assert sorted(names) == ["a"]


def test_what_is_not_computed_leaves_nothing_behind() -> None:
    """Neither the depth of brackets, nor being within a matrix, where a blank parts two numbers."""
    names: dict[str, object] = {"v": number(evaluate("[1 2 3]", {}))}
    skipped = run("a = [1 (none)];\nb = v(none(end));\n" * 40 + "c = 3 -1;\nd = end;", names)
    assert len(skipped) == 81
    assert names["c"] == 2  # type: ignore[comparison-overlap]
    assert "d" not in names


@pytest.mark.parametrize(
    "code", ["a = 1;\nwhos", "s.a = 2; s.b.c = nothing", "m = [1, 2; 3 4]';\nif m(1) > 0, b = {'t'}; end"]
)
def test_a_script_that_is_cut_anywhere_raises_nothing(code: str) -> None:
    for end in range(len(code) + 1):
        run(code[:end], names := {})
        assert set(names) <= {"a", "s", "m", "b", "ans"}


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("A = eye(300); for k = 1:1e4, A = inv(A); end", "takes more than 50000 operations"),
        ("A = eye(51); K = lqr(A, A, A, A);", "lqr of more than 50 states is not computed"),
        ("for k = 1:101, K = lqr(1, 1, 1, 1); end", "takes more than 50000 operations"),
    ],
)
def test_work_on_matrices_is_bounded(code: str, why: str) -> None:
    names: dict[str, Value] = {}
    assert [one.why for one in run(code, names)] == [why]
    assert "K" not in names


def test_braces_on_a_number_are_an_error(tmp_path: Path) -> None:
    """As in MATLAB; a table and a cell array have elements in braces."""
    (tmp_path / "two.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    names: dict[str, Value] = {}
    script = "n = readmatrix('two.csv'); c = {4}; x = c{1};\nz = x{1};\nz = n{1, 2};\n"
    script += "t = readtable('two.csv'); b = t{1, 2};"
    why = "this is no cell array, or one of more than two dimensions"
    assert [(one.line, one.why) for one in run(script, names, [tmp_path])] == [(2, why), (3, why)]
    assert np.asarray(names["b"]).tolist() == [[2.0]]


def test_a_third_dimension_is_skipped_with_its_line() -> None:
    names: dict[str, Value] = {}
    (skipped,) = run("a = 1;\nA(1, 2, 3) = 4;\nb = 2;", names)
    assert (skipped.line, sorted(names)) == (2, ["a", "b"])
    assert "two dimensions" in skipped.why


def test_a_script_designs_gains_and_keeps_the_fields_that_it_knows() -> None:
    names: dict[str, Value] = {}
    code = """A = [0 1; 2 -3]; B = [0; 4]; Q = diag([2 1]); R = .5; p.m = 3;
    [K, S] = lqr(A, B, Q, R); [N, T] = lqr(A, B, Q, R, [.1; .2]); p.k = unknown(A); p.n = 4;
    L = dlqr(eye(2) + .1 * A, .1 * B, Q, R); P = place(A, B, [-3 -5]);"""
    assert [one.why for one in run(code, names)] == ["unknown is not computed"]
    a, b, q, r = np.array([[0.0, 1.0], [2.0, -3.0]]), np.array([[0.0], [4.0]]), np.diag([2.0, 1.0]), 0.5
    k, s = names["K"], names["S"]
    assert np.allclose(a.T @ s + s @ a - s @ b @ b.T @ s / r + q, 0.0, atol=1e-9)  # its Riccati equation
    assert np.allclose(k, b.T @ s / r, rtol=1e-12, atol=0.0)
    k, s = names["N"], names["T"]
    both = s @ b + [[0.1], [0.2]]
    assert np.allclose(a.T @ s + s @ a - both @ both.T / r + q, 0.0, atol=1e-9)
    assert np.allclose(k, both.T / r, rtol=1e-12, atol=0.0)
    closed, cost = np.eye(2) + 0.1 * (a - b @ names["L"]), np.zeros((2, 2))
    for _ in range(5000):  # the cost that the gain leads to
        cost = q + names["L"].T @ names["L"] * r + closed.T @ cost @ closed
    least = np.linalg.solve(r + 0.01 * b.T @ cost @ b, 0.1 * b.T @ cost @ (np.eye(2) + 0.1 * a))
    assert np.allclose(names["L"], least, rtol=1e-9, atol=0.0)  # no other gain of one step costs less
    assert np.allclose(np.sort(np.linalg.eigvals(a - b @ names["P"])), [-5.0, -3.0], rtol=1e-12, atol=0.0)
    assert {name: float(value[0, 0]) for name, value in names["p"].items()} == {"m": 3.0, "n": 4.0}


def test_a_function_of_a_file_gives_the_base_workspace_buses(tmp_path: Path) -> None:
    (tmp_path / "buses.m").write_text(
        """function buses()
make = @(rows) one_of(rows);
assignin('base', 'Pair', make({'a', 'first'; 'b', 'second'}));
Simulink.Bus.createObject(struct('v', zeros(3, 1), 'on', true));
end
% the elements of one bus
function bus = one_of(rows)
  elements = Simulink.BusElement.empty(0, 1);
  for k = 1:size(rows, 1)
    e = Simulink.BusElement; e.Name = rows{k, 1}; e.Description = rows{k, 2};
    elements(k, 1) = e;
  end
  bus = Simulink.Bus; bus.Elements = elements;
end
""",
        encoding="utf-8",
    )
    names: dict[str, Value] = {}
    code = 'buses();\nc = {1 2; 3 4}; order = [c{3} c{2} c{2, 2}];\nmode = "AB"; is = [mode == "AB", mode == "B"];'
    assert run(code, names, [tmp_path]) == []
    pair, made = names["Pair"]["Elements"], names["slBus1"]["Elements"]
    assert [(one["Name"], one["Description"]) for one in pair] == [("a", "first"), ("b", "second")]
    assert [one["Name"] for one in made] == ["v", "on"]
    bus = kind_of("Bus: slBus1", names)
    assert isinstance(bus, Bus)
    assert [(one.name, one.kind, one.width) for one in bus.fields] == [("v", "real", 3), ("on", "bool", None)]
    assert names["order"].tolist() == [[2.0, 3.0, 4.0]]
    assert names["is"].tolist() == [[True, False]]


def test_a_bus_behind_one_without_a_name_is_not_named() -> None:
    names: dict[str, Value] = {}
    code = "s.a = 1;\nSimulink.Bus.createObject(unknown);\nb = Simulink.Bus.createObject(s);\nbus = slBus1;"
    assert [one.line for one in run(code, names)] == [2, 3, 4]
    assert "bus" not in names


def test_a_continuous_system_is_sampled() -> None:
    names: dict[str, Value] = {}
    assert run("d = c2d(ss([0 1; 0 0], [0; 2], [1 0], 0), .5, 'zoh');", names) == []
    assert np.allclose(names["d"]["A"], [[1.0, 0.5], [0.0, 1.0]], rtol=0.0, atol=1e-15)
    assert np.allclose(names["d"]["B"], [[0.25], [1.0]], rtol=0.0, atol=1e-15)
