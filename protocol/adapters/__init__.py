"""The only places that know zenoh and mcap."""
