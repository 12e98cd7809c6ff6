"""What makes and judges the streams; mining never imports it."""
