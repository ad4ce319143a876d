"""Evidence, written and read: logs, charts, the page, JUnit results, the manifest. Renders neutral records; judges nothing."""
