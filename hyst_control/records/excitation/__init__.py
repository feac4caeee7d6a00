"""Reference and excitation signals."""
