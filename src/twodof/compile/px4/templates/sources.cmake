# PX4 adds the modules of this list to its own.
set(config_module_list_external
    modules/${module}
    PARENT_SCOPE
)
