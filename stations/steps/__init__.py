"""Step functions, by subject. Each is registered under the name that plans use.

A step measures and carries values on; it judges nothing: limits are the plan's.
"""
