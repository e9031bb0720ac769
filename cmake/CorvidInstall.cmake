# Installs the library (headers, static rooms, a package file for find_package(corvid)) and the program.
include(GNUInstallDirs)
install(DIRECTORY include/corvid DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(TARGETS corvid_program RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
