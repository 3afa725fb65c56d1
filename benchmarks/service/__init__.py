"""The daemon under load: latency, memory, drops, real time; vehicle, subscriber and watcher are processes of their own."""
