"""Made worlds and recordings; what they give cannot be told from what a real robot gives."""
