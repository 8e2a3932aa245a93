"""What a scan is, its images and videos; `table` lists the layouts of its folders, `read` reads them."""
