"""Motions on one page that opens from disk, without a network: see ``refine.viewer.page``."""
