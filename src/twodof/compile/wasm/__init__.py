"""WebAssembly: the module, its interface, and the engine wasmtime. See docs/reference/compilation.md."""
