# Installs the library (headers, one static archive per room, a package file for
# find_package(corvid)) and the program.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(CORVID_ROOMS core kernels frontend backend mapping io replay engine)
set(CORVID_PACKAGE_DIR "${CMAKE_INSTALL_LIBDIR}/cmake/corvid")
list(TRANSFORM CORVID_ROOMS PREPEND corvid_ OUTPUT_VARIABLE room_targets)

install(DIRECTORY include/corvid DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
# The openers of sources, trajectories and options belong to the library's users too.
install(FILES io/source.h io/trajectory_file.h io/options_file.h io/mesh_files.h
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/io)
install(FILES replay/synthetic_flight.h replay/player.h
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/replay)
install(FILES core/clock.h core/log.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/core)
install(TARGETS ${room_targets} corvid_draco corvid_opencv EXPORT corvid_targets
        ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(EXPORT corvid_targets NAMESPACE corvid:: FILE corvid-targets.cmake
        DESTINATION ${CORVID_PACKAGE_DIR})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/corvidConfig.cmake.in
  ${PROJECT_BINARY_DIR}/corvidConfig.cmake INSTALL_DESTINATION ${CORVID_PACKAGE_DIR})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/corvidConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/corvidConfig.cmake ${PROJECT_BINARY_DIR}/corvidConfigVersion.cmake
        DESTINATION ${CORVID_PACKAGE_DIR})

install(TARGETS corvid_program RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(FILES README.md LICENSE NOTICE CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR})
