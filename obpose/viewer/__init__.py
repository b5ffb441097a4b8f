"""The web page of `obpose-view`: view, edit, sample and save scenes."""
