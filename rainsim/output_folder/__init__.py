"""Output folders: checked before use, filled file by file, with a record of all written files.

`provenance.json` in a folder names the files that the program wrote there; only these are ever
removed or replaced, and only when new results are ready to take their place.
"""
