"""Any skeleton to SMPL's 24 joints: which of its joints is which, where their axes lie, and the motion turned over."""
