# PX4 makes uORB topics of the messages of this list.
set(config_msg_list_external
    ${class_name}.msg
    PARENT_SCOPE
)
