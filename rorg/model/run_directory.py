"""Places in the directory of rorg's sockets that containers mount. A tree does not say which directory that is."""

RUN = "${rorg.run}"
"""A placeholder for the directory, until it is known which rorg runs this tree."""


def socket_folder(service: str) -> str:
    """Return the directory of the socket by which a service talks to rorg."""
    return f"{RUN}/services/{service}"


def parameter_folder(service: str) -> str:
    """Return the directory of a service's file of ROS 2 parameters."""
    return f"{RUN}/parameters/{service}"
