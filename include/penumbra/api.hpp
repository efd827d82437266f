// Marks what the shared library exports, and members of exported classes that it does not.
#pragma once

#define PENUMBRA_API __attribute__((visibility("default")))
#define PENUMBRA_LOCAL __attribute__((visibility("hidden")))
