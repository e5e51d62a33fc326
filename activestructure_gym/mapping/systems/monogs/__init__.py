"""MonoGS on given poses."""
