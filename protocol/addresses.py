# pyright: strict
"""Where the processes of a line are found unless somebody says otherwise."""

DEFAULT_LINE = "demo"
LOOPBACK = "127.0.0.1"
ROUTER_PORT = 7447
"""Zenoh's own."""
DASHBOARD_PORT = 8080
DEFAULT_ROUTER = f"tcp/{LOOPBACK}:{ROUTER_PORT}"
