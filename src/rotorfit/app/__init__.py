"""Application: the workflows behind the verbs, the command line, the terminal, the local web page, and the demo.

Arguments and clicks go in; calls of the library come out, with their results in words.
"""
