"""What server and client share: topics, message headers, frames, commands as messages, and the transport."""
