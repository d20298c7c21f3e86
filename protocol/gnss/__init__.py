"""What a satellite receiver says: UBX and NMEA 0183, both ways, and a parser of a stream that has both.

Pure: bytes in, values out. Angles in rad, lengths in m, speeds in m/s.
"""
