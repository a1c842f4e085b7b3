"""What PX4's build reads: two lists of what is external, and the module's CMakeLists.txt."""

from __future__ import annotations

from twodof.compile.px4.names import ModuleNames

# The language's rules: no contraction, no reassociation, IEEE division, signed zeros. PX4's flags come before, and
# CMake drops one that PX4 has given already: -fno-fast-math, say, would switch errno on, and nothing switch it off.
EXACT = (
    "-ffp-contract=off",
    "-fno-associative-math",
    "-fno-reciprocal-math",
    "-fno-finite-math-only",
    "-fsigned-zeros",
)


def source_list(names: ModuleNames) -> str:
    """src/CMakeLists.txt."""
    return f"""# PX4 adds the modules of this list to its own.
set(config_module_list_external
    modules/{names.module}
    PARENT_SCOPE
)
"""


def message_list(names: ModuleNames) -> str:
    """msg/CMakeLists.txt."""
    return f"""# PX4 makes uORB topics of the messages of this list.
set(config_msg_list_external
    {names.class_name}.msg
    PARENT_SCOPE
)
"""


def module_list(names: ModuleNames, stack: int) -> str:
    """The module's CMakeLists.txt; `stack` is the largest frame that may be [bytes]."""
    flags = "\n".join(f"        {flag}" for flag in EXACT)
    return f"""px4_add_module(
    MODULE modules__{names.module}
    MAIN {names.module}
    STACK_MAIN 2500
    STACK_MAX {stack}
    COMPILE_FLAGS
        # The controller computes the same bits here as on the host.
{flags}
    SRCS
        {names.module}.c
        {names.class_name}.cpp
    MODULE_CONFIG
        module.yaml
    EXTERNAL
    )
"""
