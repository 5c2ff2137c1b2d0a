"""Scan matchers: where a scan was taken, seen from a reference that earlier scans have made."""
