"""A capture in the rain in a browser: when parts are drawn, costs of changes, files to take home.

`page` alone imports viser; everything else runs without a browser.
"""
