"""The MHL family: Madelung curves, rate correction, delay and linear dynamics."""
