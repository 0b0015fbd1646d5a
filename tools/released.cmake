# The generated sources of a release archive (tools/release) in the place of the generators. They are refused once one of
# the files that they were made from is another.
file(STRINGS ${PROJECT_SOURCE_DIR}/generated/SHA256SUMS sums)
foreach(line IN LISTS sums)
  string(REGEX MATCH "^([0-9a-f]+)  (.+)$" _ "${line}")
  set(wanted ${CMAKE_MATCH_1})
  set(source ${CMAKE_MATCH_2})
  file(SHA256 ${PROJECT_SOURCE_DIR}/${source} found)
  if(NOT found STREQUAL wanted)
    message(
      FATAL_ERROR
        "${source} was changed, so the sources in generated/ are not its own any more: "
        "remove the folder generated/, and let tools/setup board install Python and what makes them anew")
  endif()
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/${source})
endforeach()
file(GLOB sources RELATIVE ${PROJECT_SOURCE_DIR}/generated ${PROJECT_SOURCE_DIR}/generated/*.[ch])
foreach(source IN LISTS sources)
  configure_file(${PROJECT_SOURCE_DIR}/generated/${source} ${GENERATED}/${source} COPYONLY)
endforeach()
