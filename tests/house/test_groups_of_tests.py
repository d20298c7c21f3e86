"""Tests that share a line, a browser or fixed addresses stay together on one worker."""

import pytest


@pytest.mark.xdist_group("house")
def test_a_group_of_tests_is_heeded(request: pytest.FixtureRequest) -> None:
    """pytest-xdist marks a grouped test's id; where it cannot, groups are silently torn apart."""
    if getattr(request.config.option, "loadgroup", False):
        assert request.node.nodeid.endswith("@house")
