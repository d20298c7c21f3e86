"""The only places that know zenoh and mcap, and the one that says how every process logs."""
