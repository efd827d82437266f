// Caches what a pass derives from casting models.
#pragma once

#include <map>
#include <memory>
#include <utility>

#include "render/scene/scene.hpp"

namespace penumbra {

template <class Derived>
class CastingModels {
 public:
  // Returns make(model) for the model that casts an object's shadows. It is made again when an
  // animation has changed the object's shape.
  template <class Make>
  const Derived& of(const Scene& scene, int object, bool proxies, const Make& make) {
    const SceneObject& caster = scene.objects[static_cast<std::size_t>(object)];
    const std::shared_ptr<const Model>& model = casting_model(caster, proxies);
    Entry& entry = caster.playback.model ? entries_[{nullptr, object}] : entries_[{model.get(), 0}];
    if (entry.model != model) {
      entry.derived = std::make_unique<Derived>(make(*model));
      entry.model = model;
    }
    return *entry.derived;
  }

 private:
  struct Entry {
    std::shared_ptr<const Model> model;
    std::unique_ptr<Derived> derived;
  };
  // Key: a rigid model, which several objects may share, or an object with an animation.
  std::map<std::pair<const Model*, int>, Entry> entries_;
};

}  // namespace penumbra
