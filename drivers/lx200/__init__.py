"""The Meade LX200 serial protocol: its codec, a mount that speaks it, and a fake that answers it."""
