"""Command-line commands: parsing and printing only.

``cli`` imports a file only when one of its commands is used.
"""
