"""WebAssembly: the module, its interface, and wasmtime that runs it. See docs/reference/compilation.md."""
