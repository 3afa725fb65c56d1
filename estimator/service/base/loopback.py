"""Whether a host is this machine itself: decided by the address, never by how its name begins."""

import ipaddress


def is_loopback(host: str) -> bool:
    """Of an address literal or the exact name localhost; any other name may lead anywhere (127.0.0.1.example, 127.1)."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return "%" not in host and (mapped or address).is_loopback
