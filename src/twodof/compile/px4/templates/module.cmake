px4_add_module(
    MODULE modules__${module}
    MAIN ${module}
    STACK_MAIN 2500
    STACK_MAX ${stack}
    COMPILE_FLAGS
        # The controller computes the same bits here as on the host.
${flags}
    SRCS
        ${module}.c
        ${class_name}.cpp
    MODULE_CONFIG
        module.yaml
    EXTERNAL
    )
