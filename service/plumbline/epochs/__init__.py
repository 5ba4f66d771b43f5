"""Messages to epochs, and what positioning needs to know of the satellites at that instant.

stream            bytes → messages → books: the decoder of one stream
time_base         which week a stream means
assembler         observation messages → epochs, by time
translate_*       ephemeris and SSR messages ↔ records
*_book            ephemerides and corrections as of a receive time; `matched_corrections` puts them together
history           how far back those answers reach
time_matching     inertial samples onto the time line of the solutions
recording         a file of frames → pieces with times
"""
