"""Accuracy against time: cases with exact solutions, runs on every scheme, tables and charts."""
