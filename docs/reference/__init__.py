"""Reference pages of the site, written when it is built."""
