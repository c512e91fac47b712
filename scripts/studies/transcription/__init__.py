"""Chapter 7's training written a second time, in NumPy alone, to judge the library's by."""
