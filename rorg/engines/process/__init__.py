"""The process engine: plain processes of this machine."""
