"""Blocks of matrices for random diagrams: random operations on matrices, vectors and numbers that stay small."""

import random
from typing import Any

from twodof.blocks import Block, Param, Port, State, array_of, cross, matrix, maximum, minimum, norm, outer, sum, where

SIZE = 3
SQUARE, ROW, NUMBER = (SIZE, SIZE), (SIZE,), ()


class FilledMatrix(Block):
    """A matrix of a vector, for a diagram that does not have another one."""

    inputs = (Port("v", width=SIZE),)
    outputs = (Port("y", shape=SQUARE),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return matrix([u.v, 0.5 * u.v, 1.0 - u.v]).T


class RandomMatrices(Block):
    """Operations that `seed` draws, on a matrix, a vector, an index, two states and a parameter."""

    inputs = (Port("m", shape=SQUARE), Port("v", width=SIZE), Port("k", "int32"))
    outputs = (Port("y", shape=SQUARE), Port("w", width=SIZE), Port("z"))
    states = (State("a", 0.25, shape=SQUARE), State("b", [1.0, -0.5, 2.0], width=SIZE))
    params = (Param("g", [[0.5, 0.1, 0.0], [-0.2, 0.4, 0.3], [0.0, -0.6, 0.7]], shape=SQUARE),)

    def __init__(self, seed: int, operations: int = 6) -> None:
        self.seed, self.operations = seed, operations

    def pool(self, u: Any, x: Any, p: Any, seed: int) -> dict[tuple[int, ...], list[Any]]:
        """Return the values after some random operations, by shape."""
        r = random.Random(seed)
        found: dict[tuple[int, ...], list[Any]] = {
            SQUARE: [u.m, x.a, p.g],
            ROW: [u.v, x.b],
            NUMBER: [u.v[0], x.a[1, 2], u.m[u.k, 0]],
        }

        def one(shape: tuple[int, ...]) -> Any:
            return r.choice(found[shape][-3:] if r.random() < 0.7 else found[shape])

        for _ in range(self.operations):
            a, b, v, w, n = one(SQUARE), one(SQUARE), one(ROW), one(ROW), one(NUMBER)
            at, way = r.randrange(SIZE), r.choice((-1, 1))
            matrices = (
                lambda a=a, b=b: a @ b,
                lambda a=a, b=b: a @ b.T,
                lambda a=a, b=b: a.T + b,
                lambda a=a, n=n: n * a,
                lambda a=a, v=v, w=w: a - outer(v, w),
                lambda v=v, w=w: outer(v, w).T,
                lambda a=a, b=b, v=v, at=at: where(a < v[at], b, a),
                lambda a=a, way=way: a[::way, ::-way],
                lambda a=a, v=v, w=w: matrix([v, a[1], w]),
            )
            vectors = (
                lambda a=a, v=v: a @ v,
                lambda a=a, v=v: v @ a,
                lambda a=a, at=at: a[:, at],
                lambda a=a, v=v, at=at: a[at] - v,
                lambda v=v, w=w: cross(v, w),
                lambda v=v, n=n: v / (2.0 + n * n),
                lambda a=a: array_of(SIZE, lambda i: a[i, u.k] + a[i, i]),
            )
            scalars = (
                lambda a=a, at=at: a[at, u.k],
                lambda v=v, w=w: v @ w,
                lambda a=a: sum(a),
                lambda v=v: norm(v),
                lambda a=a: a[u.k, u.k - 1],
            )
            shape = r.choice((SQUARE, SQUARE, ROW, ROW, NUMBER))
            found[shape].append(r.choice({SQUARE: matrices, ROW: vectors, NUMBER: scalars}[shape])())
        return found

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        last = self.pool(u, x, p, self.seed)
        return {"y": last[SQUARE][-1], "w": last[ROW][-1], "z": last[NUMBER][-1]}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        last = self.pool(u, x, p, self.seed + 1)
        return {"a": minimum(9.0, maximum(-9.0, last[SQUARE][-1])), "b": where(abs(last[ROW][-1]) < 9.0, x.b, 0.5)}
