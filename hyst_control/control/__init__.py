"""Controllers: feedforward compensators and PI feedback, and the loop they close."""
