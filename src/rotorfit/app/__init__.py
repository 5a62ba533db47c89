"""Compositions and faces: the workflows behind the verbs, the command line, the terminal, the local web page, the
demo.

In go arguments and clicks; out come calls of the library and their results in words.
"""
