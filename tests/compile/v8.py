"""WebAssembly in V8, the engine of node and of browsers: another engine than the one twodof brings, as a Target."""

from __future__ import annotations

import base64
import json
import subprocess
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.patience import PATIENCE_S
from twodof.compile.target import EmittedProgram
from twodof.compile.wasm.module import WasmModule, compile_module

HOST = """
const fs = require("fs");
const { module: file, programs } = JSON.parse(fs.readFileSync(process.argv[1], "utf8"));
const wasm = new WebAssembly.Module(fs.readFileSync(file));
if (WebAssembly.Module.imports(wasm).length) throw new Error("the module imports something");
const { exports } = new WebAssembly.Instance(wasm, {});
const memory = () => new Uint8Array(exports.memory.buffer);
const put = (text, address) => memory().set(Buffer.from(text, "base64"), address);
const get = (address, size) => Buffer.from(memory().slice(address, address + size));
function answer({ program, call, P, S, u, steps, stride }) {
  const { structs, rows, functions } = programs[program];
  const at = Object.fromEntries(Object.entries(structs).map(([k, s]) => [k, s.address]));
  put(P, at.P); put(S, at.S);
  const y = [];
  if (call === "defaults" || call === "prepare") exports[functions[call]](at.P);
  else if (call === "init") exports[functions.init](at.P, at.S);
  else {
    const inputs = Buffer.from(u, "base64");
    for (let k = 0; k < steps; k += rows.count) {
      const n = Math.min(rows.count, steps - k), size = rows.U.stride;
      memory().set(stride ? inputs.subarray(k * size, (k + n) * size) : inputs, rows.U.address);
      exports[functions.run](at.P, at.S, rows.U.address, stride, rows.Y.address, 1, n);
      y.push(get(rows.Y.address, n * rows.Y.stride));
    }
  }
  const text = (k) => get(at[k], structs[k].size).toString("base64");
  return { P: text("P"), S: text("S"), y: Buffer.concat(y).toString("base64") };
}
require("readline").createInterface({ input: process.stdin }).on("line", (line) => {
  process.stdout.write(JSON.stringify(answer(JSON.parse(line))) + "\\n");
});
"""


@dataclass(frozen=True)
class V8:
    """The module of twodof's target "wasm", run by node."""

    optimise: str = "-O3"
    name = "v8"

    def compile(self, programs: Sequence[EmittedProgram]) -> list[V8Backend]:
        """The programs of one source in one module and one process of node."""
        host = Host(compile_module(programs, None, self.optimise))
        return [V8Backend(program, host) for program in programs]


class Host:
    """A process of node that answers calls on the programs of a module."""

    def __init__(self, module: WasmModule) -> None:
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        (folder / "module.wasm").write_bytes(module.data)
        about = {"module": str(folder / "module.wasm"), "programs": {n: module.interface(n) for n in module.programs}}
        (folder / "about.json").write_text(json.dumps(about))
        self._node = subprocess.Popen(
            ["timeout", "600", "node", "-e", HOST, str(folder / "about.json")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._end = weakref.finalize(self, _end, self._node, self._folder)

    def call(self, **request: Any) -> dict[str, Any]:
        """Node's answer to a request."""
        stdin, stdout = self._node.stdin, self._node.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(json.dumps(request) + "\n")
        stdin.flush()
        answer: dict[str, Any] = json.loads(stdout.readline())
        return answer


def _end(node: subprocess.Popen[str], folder: tempfile.TemporaryDirectory[str]) -> None:
    node.kill()
    node.wait(PATIENCE_S)
    for stream in (node.stdin, node.stdout):
        if stream is not None:
            stream.close()
    folder.cleanup()


class V8Backend:
    """A program of the module."""

    def __init__(self, program: EmittedProgram, host: Host) -> None:
        self.program = program
        self.host = host

    def instance(self) -> V8Instance:
        """A fresh instance."""
        return V8Instance(self)


class V8Instance:
    """One running program, whose structs go to node and back with each call."""

    def __init__(self, backend: V8Backend) -> None:
        self.structs: dict[str, NDArray[Any]] = {k: np.zeros(1, t) for k, t in backend.program.dtypes.items()}
        self._host, self._program = backend.host, backend.program.name
        self.defaults = partial(self._call, "defaults")
        self.prepare = partial(self._call, "prepare")
        self.init = partial(self._call, "init")

    def _call(self, call: str, **more: Any) -> bytes:
        state = {k: base64.b64encode(self.structs[k].tobytes()).decode() for k in "PS"}
        answer = self._host.call(program=self._program, call=call, **state, **more)
        for k in "PS":
            self.structs[k][:] = np.frombuffer(base64.b64decode(answer[k]), self.structs[k].dtype)
        return base64.b64decode(answer["y"])

    def step(self) -> None:
        """One tick."""
        self.run(1, self.structs["U"], self.structs["Y"])

    def run(self, steps: int, u: NDArray[Any], y: NDArray[Any]) -> None:
        """`steps` ticks; see `target.Instance`."""
        given = base64.b64encode(u.tobytes()).decode()
        rows = np.frombuffer(self._call("run", u=given, steps=steps, stride=int(len(u) > 1)), y.dtype)
        if steps:
            y[:] = rows[-1:] if len(y) == 1 else rows
