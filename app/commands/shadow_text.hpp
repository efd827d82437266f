// A shadow as JSON, as a table and as a picture.
#pragma once

#include <string>

#include "app/commands/shadow_job.hpp"
#include "app/commands/shadow_layers.hpp"
#include "app/output/shadow_picture.hpp"

namespace penumbra {

[[nodiscard]] std::string shadow_json(const ShadowJob& job, const ShadowResult& result);
[[nodiscard]] std::string shadow_table(const ShadowJob& job, const ShadowResult& result);
[[nodiscard]] ShadowPicture picture_of(const ShadowJob& job, const ShadowResult& result);

}  // namespace penumbra
