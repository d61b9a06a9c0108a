"""Boards: facts of each that software needs."""
