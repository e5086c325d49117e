"""Command-line commands: parsing and printing only."""
