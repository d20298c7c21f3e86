"""What a satellite receiver sends: UBX NAV-PVT and NMEA 0183. Reading is a client's: pyubx2 reads both.

Pure: values in, bytes out. Angles in rad, lengths in m, speeds in m/s.
"""
