"""A capture in the rain in a browser: what is drawn when, what a change costs, what is taken home.

`page` alone imports viser; everything else runs without a browser.
"""
