"""URL handlers for pyserial; `stations.drivers.serial_port` makes `lockstep://` known to `serial_for_url`.

pyserial finds `protocol_<scheme>.py` in the packages of `serial.protocol_handler_packages`.
"""
