"""Results for people and programs: tables, lists of written files, HTML pages."""
