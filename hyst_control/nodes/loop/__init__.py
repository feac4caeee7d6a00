"""Parts of the nodes of the loop: actuator, takeover, watch over rivals, learning, recorded topics."""
