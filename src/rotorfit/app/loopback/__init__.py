"""Pages on 127.0.0.1: the gate, the socket and the server of the studio and of the live page, and their files."""
