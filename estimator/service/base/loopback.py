"""Whether a host is this machine, by its address."""

import ipaddress


def is_loopback(host: str) -> bool:
    """An address literal or localhost; 127.0.0.1.example may resolve anywhere."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return "%" not in host and (mapped or address).is_loopback
